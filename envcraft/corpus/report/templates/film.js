"use strict";
/* A preview is one picture with its frames below each other. It moves while somebody points at it. */
const still = matchMedia("(prefers-reduced-motion: reduce)");
const films = new WeakMap();

function play(image) {
  const frames = image.naturalWidth ? Math.round(image.naturalHeight / image.naturalWidth) : 0;
  if (frames < 2 || films.has(image)) return;
  const moves = [{ objectPosition: "50% 0%" }, { objectPosition: "50% 100%" }];
  const timing = { duration: frames * 140, easing: `steps(${frames}, jump-none)`, iterations: Infinity };
  films.set(image, image.animate(moves, timing));
}

function stop(image) {
  films.get(image)?.cancel();
  films.delete(image);
}

const filmOf = (target) => (target instanceof Element ? target.closest("a, .filmed")?.querySelector(".film") : null);
for (const [name, does] of [["mouseover", play], ["focusin", play], ["mouseout", stop], ["focusout", stop]]) {
  document.addEventListener(name, (event) => {
    const film = filmOf(event.target);
    if (film && !film.dataset.kept && !still.matches) does(film);
  });
}
