/* Live play: an episode in a sandbox, over a WebSocket. Each binary message has the length of a JSON text, that text, and
   the pixels of a frame. */
const KEYS = { ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right", " ": "space", Enter: "enter" };
const MOST_BYTES = 96 * 2 ** 20;
let socket = null;

function leave() {
  socket?.close();
  socket = null;
}

const keyOf = (event) => KEYS[event.key] ?? (event.key.length === 1 ? event.key.toLowerCase() : "");

/* The frames of an episode as they arrive; the first are dropped when there are too many. */
class Film {
  constructor() { this.clear(); this.size = { width: 84, height: 84 }; this.rate = 15; }
  clear() { this.shots = []; this.dropped = 0; this.bytes = 0; }
  get frames() { return this.dropped + this.shots.length; }
  shot(number) { return this.shots[Math.max(number - this.dropped, 0)]; }
  draw(context, number) {
    const { told, pixels } = this.shot(number);
    if (!pixels.length) return;
    if (context.canvas.width !== told.width || context.canvas.height !== told.height) Object.assign(context.canvas, { width: told.width, height: told.height });
    const image = context.createImageData(told.width, told.height);
    for (let from = 0, to = 0; from < pixels.length; from += 3, to += 4) {
      image.data[to] = pixels[from]; image.data[to + 1] = pixels[from + 1]; image.data[to + 2] = pixels[from + 2]; image.data[to + 3] = 255;
    }
    context.putImageData(image, 0, 0);
  }
  step(number) { return this.shot(number)?.told ?? { reward: 0, total: 0 }; }
  add(told, pixels) {
    this.shots.push({ told, pixels });
    this.bytes += pixels.length;
    while (this.bytes > MOST_BYTES) { this.bytes -= this.shots.shift().pixels.length; this.dropped += 1; }
  }
}

function stage(about) {
  const reel = new Film();
  const view = playback(reel, "The game: click it and use the keys");
  const large = view.element.querySelector(".large");
  large.tabIndex = 0;
  large.setAttribute("role", "application");
  const state = make("p", "state soft", "Press Play to start an episode");
  state.setAttribute("role", "status");
  const seed = Object.assign(make("input", "seed"), { type: "number", min: 0, max: 2 ** 31 - 1, value: 0 });
  const rate = make("select", "", ...[1, 5, 10, 15, 30, 60].map((value) => Object.assign(make("option", "", `${value} steps/s`), { value, selected: value === 15 })));
  // Keys that are down, and keys of actions.
  const held = new Set(), taken = new Set(), pad = make("div", "pad"), help = make("p", "small help");
  let paused = false, running = false, following = true;
  const send = (message) => { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); };
  const begin = () => {
    following = true;
    const start = { do: "start", seed: Number(seed.value) || 0, on: paused };
    if (socket?.readyState === WebSocket.OPEN) { reel.clear(); send(start); } else connect(start);
    large.focus();
  };
  const hold = () => {
    paused = !paused;
    pausing.textContent = paused ? "Continue" : "Pause";
    send({ do: "pause", on: paused });
    if (running) state.textContent = paused ? "Paused: each key takes a step" : "Playing";
  };
  const start = button("Play", begin), pausing = button("Pause", hold);
  const step = button("Step", () => { if (!paused) hold(); send({ do: "step" }); }, "Take one step with the held keys");
  const save = button("Save", () => send({ do: "save" }), "Save the episode for `envcraft replay`");
  view.rows.querySelector("input").addEventListener("input", () => { following = view.at === reel.frames - 1; });

  function connect(first) {
    leave();
    state.textContent = "Starting\u2026";
    const mine = socket = new WebSocket(`ws://${location.host}/live/play`);
    mine.binaryType = "arraybuffer";
    mine.onopen = () => { reel.clear(); mine.send(JSON.stringify({ environment: about.name, number: about.number, ...first })); };
    mine.onclose = () => { running = false; if (mine === socket) { socket = null; if (!state.dataset.final) state.textContent = "Not running"; } };
    mine.onmessage = (event) => (typeof event.data === "string" ? told(JSON.parse(event.data)) : frame(event.data));
  }
  function told(message) {
    delete state.dataset.final;
    if (message.kind === "ready") {
      running = true;
      reel.rate = message.rate;
      rate.value = [1, 5, 10, 15, 30, 60].find((value) => value >= message.rate) ?? 60;
      help.textContent = [...message.help, "r plays again, p pauses, Escape leaves the game"].join("; ");
      taken.clear();
      for (const [key] of message.pad) taken.add(key);
      pad.replaceChildren(...message.pad.map(([key, words]) => touch(key, words)));
      large.dataset.running = "1";
      state.textContent = message.turns ? "Each step waits for a key" : paused ? "Paused: each key takes a step" : "Playing";
    } else if (message.kind === "saved") {
      const link = Object.assign(make("a"), { download: message.name, href: `data:application/json;charset=utf-8,${encodeURIComponent(message.report)}` });
      link.click();
      running = false;
      state.textContent = `Saved: envcraft replay ${message.name}`;
    } else {
      state.textContent = message.words;
      state.dataset.final = "1";
      delete large.dataset.running;
    }
  }
  function frame(data) {
    const length = new DataView(data).getUint32(0);
    const message = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    reel.add(message, new Uint8Array(data, 4 + length));
    if (following) view.show(reel.frames - 1);
    large.dataset.frames = reel.frames;
  }
  function press(key, down) {
    if (!key) return;
    if (down && !held.has(key)) { held.delete(key); held.add(key); send({ do: "press", key, held: [...held] }); }
    if (!down && held.delete(key)) send({ do: "release", held: [...held] });
  }
  function touch(key, words) {
    const made = make("button", `key-${key}`, words);
    made.type = "button";
    for (const [name, down] of [["pointerdown", true], ["pointerup", false], ["pointerleave", false], ["pointercancel", false]]) {
      made.addEventListener(name, (event) => { event.preventDefault(); press(key, down); });
    }
    // Enter and Space press a button that has the focus.
    made.addEventListener("click", (event) => { if (!event.detail) { press(key, true); press(key, false); } });
    return made;
  }
  large.addEventListener("keydown", (event) => {
    if (event.key === "Tab" || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    if (event.key === "Escape") large.blur();
    else if (event.key === "p" && !taken.has("p")) { if (!event.repeat) hold(); }
    else if (event.key === "r" && !taken.has("r")) { if (!event.repeat) begin(); }
    else if (!running && event.key === "Enter") begin();
    else press(keyOf(event), true);
  });
  large.addEventListener("keyup", (event) => press(keyOf(event), false));
  large.addEventListener("blur", () => { for (const key of [...held]) press(key, false); });
  large.addEventListener("click", () => { if (!running) begin(); });
  rate.addEventListener("input", () => { reel.rate = Number(rate.value); send({ do: "rate", rate: reel.rate }); });
  const controls = make("div", "controls", start, pausing, step, save, make("label", "", "Seed ", seed), make("label", "", "Speed ", rate));
  return [part("play", "Play", controls, view.element, pad, state, help), watch(about)];
}

/* Policies side by side, and the replay of findings: recorded in the sandbox on request. */
async function fetched(about, wanted) {
  const answer = await fetch(`live/episode?${new URLSearchParams({ environment: about.name, number: about.number, ...wanted })}`);
  const told = await answer.json();
  if (!answer.ok) throw new Error(told.words);
  return told;
}

function asking(act, word) {
  const said = make("span", "soft small");
  said.setAttribute("role", "status");
  const made = button(word, async () => {
    made.disabled = true;
    said.textContent = "Playing in the sandbox\u2026";
    try {
      await act();
      said.textContent = "";
    } catch (error) {
      said.textContent = error.message;
    }
    made.disabled = false;
  });
  return make("span", "asking", made, said);
}

function watch(about) {
  const side = lanes([]);
  const seed = Object.assign(make("input", "seed"), { type: "number", min: 0, max: 1_000_000, value: 0 });
  const row = make("div", "controls", make("label", "", "Episode ", seed), side.together);
  fetch(`live/players?${new URLSearchParams({ environment: about.name, number: about.number })}`).then((answer) => answer.json()).then((players) => {
    row.prepend(...players.map(([name, summary]) => {
      const made = asking(async () => side.add(await fetched(about, { player: name, episode: seed.value })).shown.start(), name);
      made.title = summary;
      return made;
    }));
    row.dataset.ready = "1";
  }).catch(() => row.prepend(make("span", "soft", "The server does not answer.")));
  return part("watch", "Watch players side by side", row, side.row);
}

function replayer(about, number) {
  const place = make("div", "replayed");
  const act = async () => {
    const { lane, shown } = recorded(await fetched(about, { finding: number }));
    place.replaceChildren(lane);
    shown.start();
  };
  return make("div", "", asking(act, "Replay"), place);
}
