"use strict";
const subjects = [...document.querySelectorAll(".subject")];
const filter = document.querySelector(".filter");
const query = document.querySelector("#query");
const shown = document.querySelector("#shown");

function sift() {
  const words = query.value.toLowerCase().split(/\s+/).filter(Boolean);
  const verdict = filter.elements.verdict.value;
  let count = 0;
  for (const subject of subjects) {
    const fits = !verdict || subject.dataset.verdict === verdict;
    subject.hidden = !(fits && words.every((word) => subject.dataset.words.includes(word)));
    count += !subject.hidden;
  }
  shown.textContent = count === subjects.length ? "" : `${count} of ${subjects.length} shown`;
}

filter.hidden = false;
filter.addEventListener("input", sift);
filter.addEventListener("submit", (event) => event.preventDefault());
document.addEventListener("keydown", (event) => {
  if (event.key === "/" && !event.target.matches("input")) {
    event.preventDefault();
    query.focus();
  }
});

function reveal() {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  if (!target) return;
  for (let parent = target; parent; parent = parent.parentElement) {
    if (parent.matches("details")) parent.open = true;
    parent.hidden = false;
  }
  target.scrollIntoView();
}
addEventListener("hashchange", reveal);
reveal();

for (const film of document.querySelectorAll(".film")) {
  const [image, button, range, output] = ["img", "button", "input", "output"].map((tag) => film.querySelector(tag));
  const expected = film.querySelectorAll("img")[1];
  const frames = JSON.parse(film.querySelector("script").textContent);
  let timer = 0;
  const show = (index) => {
    const [step, png, plain] = frames[index];
    image.src = `data:image/png;base64,${png}`;
    if (expected) expected.src = `data:image/png;base64,${plain || png}`;
    range.value = index;
    output.value = step ? `step ${step}` : "reset";
  };
  const stop = () => {
    clearInterval(timer);
    timer = 0;
    button.textContent = "Play";
  };
  const next = () => {
    const index = Number(range.value) + 1;
    if (index < frames.length) show(index);
    if (index >= frames.length - 1) stop();
  };
  button.addEventListener("click", () => {
    if (timer) return stop();
    if (Number(range.value) >= frames.length - 1) show(0);
    button.textContent = "Pause";
    timer = setInterval(next, 80);
  });
  range.addEventListener("input", () => {
    stop();
    show(Number(range.value));
  });
  film.querySelector("figcaption").hidden = frames.length < 2;
}

const save = document.querySelector("#save");
save.hidden = false;
save.addEventListener("click", () => {
  const blob = new Blob([document.querySelector("#report").textContent], { type: "application/json" });
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = "report.json";
  link.click();
  URL.revokeObjectURL(link.href);
});
