/* A screen shows one episode: its frames as the agent gets them and enlarged, rewards, flags, and a slider over its steps.
   A source has `size` (width and height), `frames` (how many), `first` (the first that it still has), `draw(context, number)`
   and `step(number)`, which has the reward, the return, the flags and the info of a step. */
const FLAGS = ["terminated", "truncated"];

function playback(source, label) {
  const [large, small] = ["large", "small"].map((kind) => Object.assign(make("canvas", kind), source.size));
  large.setAttribute("role", "img");
  large.setAttribute("aria-label", label);
  small.setAttribute("aria-hidden", "true");
  const said = make("p", "said");
  const flags = make("p", "flags");
  const slider = Object.assign(make("input", "scrub"), { type: "range", min: 0, max: 0, value: 0 });
  slider.setAttribute("aria-label", "Step");
  const word = source.toggle ?? "Play", toggle = button(word, () => (timer ? stop() : start()));
  const rows = make("div", "steps", button("\u2039", () => jump(at - 1), "One step back"), toggle,
    button("\u203a", () => jump(at + 1), "One step on"), slider);
  const size = make("figcaption", "small");
  const element = make("div", "screen", make("div", "pictures", large, make("figure", "seen", small, size)), said, flags, rows);
  rows.hidden = true;
  let at = 0, timer = 0;

  function show(number) {
    if (!source.frames) return;
    rows.hidden = false;
    at = Math.max(Math.min(number, source.frames - 1), source.first ?? 0);
    for (const canvas of [large, small]) source.draw(canvas.getContext("2d"), at);
    size.textContent = `${large.width}\u00d7${large.height}`;
    large.dataset.step = at;
    const { info: told, ...ended } = source.step(at);
    extend();
    flags.textContent = [...FLAGS.filter((flag) => ended[flag]), told].filter(Boolean).join(" \u00b7 ");
  }
  /* There are more frames than before. */
  function extend() {
    const { reward, total } = source.step(at);
    Object.assign(slider, { min: source.first ?? 0, max: Math.max(source.frames - 1, 0), value: at });
    said.textContent = `step ${at} of ${source.frames - 1}, reward ${short(reward)}, return ${short(total)}`;
  }
  function stop() {
    clearInterval(timer);
    timer = 0;
    toggle.textContent = word;
  }
  function start() {
    if (at >= source.frames - 1) show(0);
    toggle.textContent = "Pause";
    timer = setInterval(() => {
      if (at >= source.frames - 1 || !element.isConnected) stop();
      else show(at + 1);
    }, 1000 / (source.rate || 15));
  }
  const jump = (number) => { stop(); show(number); };
  slider.addEventListener("input", () => jump(Number(slider.value)));
  return { element, show, extend, start, stop, shown: large.dataset, get at() { return at; } };
}

const short = (value) => (Number.isInteger(value) ? String(value) : Number(value).toFixed(3));

/* A recorded episode: its frames are tiles of one picture. */
function recorded(episode) {
  const image = new Image();
  const { width, height, columns, rewards } = episode;
  const totals = [0];
  for (const reward of rewards) totals.push(totals.at(-1) + Number(reward));
  const last = rewards.length;
  const source = {
    size: { width, height }, frames: episode.frames, rate: episode.rate,
    draw: (context, number) => context.drawImage(image, (number % columns) * width, Math.floor(number / columns) * height, width, height, 0, 0, width, height),
    step: (number) => ({
      reward: number ? rewards[number - 1] : 0, total: totals[number],
      terminated: number === last && episode.ending === "terminated", truncated: number === last && episode.ending === "truncated",
    }),
  };
  const shown = playback(source, episode.label);
  image.addEventListener("load", () => { shown.show(0); shown.element.dataset.ready = "1"; });
  image.src = episode.picture;
  const lane = make("section", "lane", make("h3", "", episode.label), shown.element, make("p", "small", episode.words));
  return { lane, shown };
}

/* Several episodes side by side, which play together. */
function lanes(episodes) {
  const made = episodes.map(recorded);
  const row = make("div", "lanes", ...made.map(({ lane }) => lane));
  return { row, together: button("Play all", () => { for (const { shown } of made) { shown.stop(); shown.show(0); shown.start(); } }) };
}

/* Plots of recorded outcomes: one row of dots for each player. */
const SVG = "http://www.w3.org/2000/svg";

function drawn(tag, attributes, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function spread(title, players, column) {
  const every = players.flatMap((player) => player[column]);
  const [low, high] = [Math.min(...every), Math.max(...every)];
  const place = (value) => 130 + 490 * (high > low ? (value - low) / (high - low) : 0.5);
  const rows = players.flatMap((player, row) => {
    const y = 20 + row * 26, sorted = [...player[column]].sort((a, b) => a - b), middle = sorted[Math.floor(sorted.length / 2)];
    return [drawn("text", { x: 120, y: y + 4, "text-anchor": "end", class: "f-ink" }, player.player),
      ...player[column].map((value) => drawn("circle", { cx: place(value), cy: y, r: 4, class: "f-accent dot" })),
      drawn("line", { x1: place(middle), x2: place(middle), y1: y - 9, y2: y + 9, class: "s-ink" })];
  });
  const bottom = 20 + players.length * 26;
  const made = drawn("svg", { viewBox: `0 0 640 ${bottom + 14}`, class: "chart", role: "img", "aria-label": `${title} by player` }, ...rows,
    drawn("text", { x: 130, y: bottom + 6, class: "f-soft" }, short(low)), drawn("text", { x: 620, y: bottom + 6, "text-anchor": "end", class: "f-soft" }, short(high)));
  return make("figure", "figure", made, make("figcaption", "small", `${title}; the line is the median`));
}
