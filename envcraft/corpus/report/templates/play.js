/* Live play: episodes in a sandbox, each over a WebSocket. Each binary message has the length of a JSON text, that text,
   and the pixels of a frame. */
const KEYS = { ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right", " ": "space", Enter: "enter" };
const RATES = [1, 5, 10, 15, 30, 60];
const MOST_BYTES = 96 * 2 ** 20;
const sockets = new Set();

function leave() {
  for (const socket of sockets) socket.close();
}

const keyOf = (event) => KEYS[event.key] ?? (event.key.length === 1 ? event.key.toLowerCase() : "");

/* The frames of an episode as they arrive; the first are dropped when there are too many. */
class Film {
  constructor() { this.clear(); this.size = { width: 84, height: 84 }; this.rate = 15; }
  clear() { this.shots = []; this.first = 0; this.bytes = 0; }
  get toggle() { return "Replay"; }
  get frames() { return this.first + this.shots.length; }
  shot(number) { return this.shots[Math.max(number - this.first, 0)]; }
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
  take(data) {
    const length = new DataView(data).getUint32(0);
    const told = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const pixels = new Uint8Array(data, 4 + length);
    this.shots.push({ told, pixels });
    this.bytes += pixels.length;
    while (this.bytes > MOST_BYTES) { this.bytes -= this.shots.shift().pixels.length; this.first += 1; }
  }
}

/* An episode in the sandbox, shown as its frames arrive. `told` gets the other messages, and null at the end. */
class Line {
  constructor(about, reel, view, told) { Object.assign(this, { about, reel, view, told, socket: null }); }
  get open() { return this.socket?.readyState === WebSocket.OPEN; }
  send(message) { if (this.open) this.socket.send(JSON.stringify(message)); }
  close() { this.socket?.close(); }
  start(message) {
    if (this.open) { this.send(message); return; }
    this.close();
    const mine = this.socket = new WebSocket(`ws://${location.host}/live/play`);
    sockets.add(mine);
    mine.binaryType = "arraybuffer";
    mine.onopen = () => this.send({ environment: this.about.name, number: this.about.number, ...message });
    mine.onclose = () => { sockets.delete(mine); if (mine === this.socket) { this.socket = null; this.told(null); } };
    mine.onmessage = (event) => {
      if (mine !== this.socket) return;
      if (typeof event.data === "string") {
        const message = JSON.parse(event.data);
        // Frames of the episode before it may have come after the press that ended it.
        if (message.kind === "started") this.reel.clear();
        this.told(message);
        return;
      }
      // Somebody who looks at an earlier step stays there.
      const follows = this.view.at >= this.reel.frames - 1;
      this.reel.take(event.data);
      this.view.shown.frames = this.reel.frames;
      follows ? this.view.show(this.reel.frames - 1) : this.view.extend();
    };
  }
}

function speeds(choose) {
  const made = make("select", "", ...RATES.map((value) => Object.assign(make("option", "", `${value} steps/s`), { value, selected: value === 15 })));
  made.addEventListener("input", () => choose(Number(made.value)));
  return made;
}

const nearest = (rate) => RATES.find((value) => value >= rate) ?? RATES.at(-1);

/* Until the first frame, the screen shows that of the preview. */
function poster(address, reel, canvases) {
  if (!address) return;
  const image = new Image();
  image.onload = () => { if (!reel.frames) for (const canvas of canvases) canvas.getContext("2d").drawImage(image, 0, 0, image.naturalWidth, image.naturalWidth, 0, 0, canvas.width, canvas.height); };
  image.src = address;
}

function stage(about, preview) {
  const reel = new Film();
  const view = playback(reel, "The game: click it and use the keys");
  const large = view.element.querySelector(".large");
  poster(preview, reel, view.element.querySelectorAll("canvas"));
  large.tabIndex = 0;
  large.setAttribute("role", "application");
  const state = make("p", "state", "Press Play to start an episode");
  state.setAttribute("role", "status");
  const seed = Object.assign(make("input", "seed"), { type: "number", min: 0, max: 2 ** 31 - 1, value: 0 });
  const rate = speeds((value) => { reel.rate = value; line.send({ do: "rate", rate: value }); });
  // Keys that are down, and keys of actions.
  const held = new Set(), taken = new Set(), pad = make("div", "pad"), help = make("p", "small help");
  let paused = false, running = false;
  const line = new Line(about, reel, view, told);
  const send = (message) => line.send(message);
  const begin = () => {
    view.stop();
    state.textContent = "Starting\u2026";
    line.start({ do: "start", seed: Number(seed.value) || 0, on: paused });
    large.focus();
  };
  let turns = false;
  const playing = () => (turns ? "Each step waits for a key" : paused ? "Paused: each key takes a step" : "Playing");
  const hold = () => {
    paused = !paused;
    pausing.textContent = paused ? "Continue" : "Pause";
    send({ do: "pause", on: paused });
    if (running) state.textContent = playing();
  };
  const start = button("Play", begin), pausing = button("Pause", hold);
  const step = button("Step", () => { if (!paused) hold(); send({ do: "step" }); }, "Take one step with the held keys");
  const save = button("Save", () => send({ do: "save" }), "End the episode here, and save it for `envcraft replay`");
  const allow = (runs, saves) => { running = runs; step.disabled = !runs; save.disabled = !saves; };
  allow(false, false);
  function told(message) {
    if (message === null) {
      if (running) state.textContent = "Not running";
      allow(false, false);
    } else if (message.kind === "started") {
      state.textContent = playing();
      allow(true, true);
    } else if (message.kind === "ready") {
      reel.rate = message.rate;
      turns = message.turns;
      rate.value = nearest(message.rate);
      help.textContent = [...message.help, "r plays again, p pauses, Escape leaves the game"].join("; ");
      taken.clear();
      for (const [key] of message.pad) taken.add(key);
      pad.replaceChildren(...message.pad.map(([key, words]) => touch(key, words)));
      // On a phone, the picture and the buttons below it are in sight together.
      pad.scrollIntoView({ block: "nearest" });
    } else if (message.kind === "saved") {
      const link = Object.assign(make("a"), { download: message.name, href: `data:application/json;charset=utf-8,${encodeURIComponent(message.report)}` });
      link.click();
      state.textContent = `Saved: envcraft replay ${message.name}`;
      allow(false, true);
    } else {
      state.textContent = message.words;
      allow(false, message.kind === "over");
    }
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
  const controls = make("div", "controls", start, pausing, step, save, make("label", "", "Seed ", seed), make("label", "", "Speed ", rate));
  view.element.querySelector(".pictures").after(pad);
  return [part("play", "Play", controls, state, make("div", "stage", view.element, help)), watch(about)];
}

/* Players side by side, each in a sandbox of its own. */
function lane(about, name, episode, ready, ended) {
  const reel = new Film(), view = playback(reel, name);
  const state = make("p", "state soft small", "Starting\u2026"), planning = make("progress");
  state.setAttribute("role", "status");
  planning.setAttribute("aria-label", `${name} plans its episode`);
  const line = new Line(about, reel, view, (message) => {
    planning.hidden = true;
    if (message?.kind === "ready") {
      reel.rate = message.rate;
      ready(made, message.rate);
    } else if (message?.kind === "started") {
      made.running = true;
      made.pause(paused);
    } else {
      if (message || made.running) state.textContent = message?.words ?? "Not running";
      made.running = false;
    }
  });
  const close = button("\u00d7", () => { line.close(); element.remove(); ended(made); }, `Close ${name}`);
  let paused = false;
  const element = make("section", "lane", make("div", "title", make("h3", "", name), close), view.element, planning, state);
  const made = {
    element, running: false, send: (message) => line.send(message),
    pause(on) {
      paused = on;
      line.send({ do: "pause", on });
      if (made.running) state.textContent = on ? "Paused" : "Playing";
    },
    start(on) {
      paused = on;
      view.stop();
      planning.hidden = line.open;
      state.textContent = line.open ? "Starting\u2026" : "The player plans its whole episode before the first frame\u2026";
      line.start({ do: "start", player: name, seed: episode, on });
    },
  };
  return made;
}

function watch(about) {
  const row = make("div", "lanes"), playing = [];
  const seed = Object.assign(make("input", "seed"), { type: "number", min: 0, max: 1_000_000, value: 0 });
  let paused = false, chosen = false;
  const every = (message) => { for (const one of playing) one.send(message); };
  const rate = speeds((value) => { chosen = true; every({ do: "rate", rate: value }); });
  const ready = (one, its) => {
    if (chosen) one.send({ do: "rate", rate: Number(rate.value) });
    else rate.value = nearest(its);
  };
  const pausing = button("Pause all", () => {
    paused = !paused;
    pausing.textContent = paused ? "Continue all" : "Pause all";
    for (const one of playing) one.pause(paused);
  });
  const again = button("Restart all", () => { for (const one of playing) one.start(paused); });
  const step = button("Step all", () => { if (!paused) pausing.click(); every({ do: "step" }); });
  const add = (name) => {
    const one = lane(about, name, Number(seed.value) || 0, ready, () => playing.splice(playing.indexOf(one), 1));
    playing.push(one);
    row.append(one.element);
    one.start(paused);
  };
  const names = make("div", "controls players");
  fetch(`live/players?${new URLSearchParams({ environment: about.name, number: about.number })}`).then((answer) => answer.json()).then((players) => {
    names.append(...players.map(([name, summary]) => button(name, () => add(name), summary)));
    names.dataset.ready = "1";
  }).catch(() => names.append(make("span", "soft", "The server does not answer.")));
  return part("watch", "Watch players side by side", names,
    make("div", "controls", again, pausing, step, make("label", "", "Episode ", seed), make("label", "", "Speed ", rate)), row);
}

/* The replay of a finding: recorded in the sandbox on request. */
function replayer(about, number) {
  const place = make("div", "replayed"), said = make("span", "soft small");
  said.setAttribute("role", "status");
  const made = button("Replay", async () => {
    made.disabled = true;
    said.textContent = "Playing in the sandbox\u2026";
    try {
      const answer = await fetch(`live/finding?${new URLSearchParams({ environment: about.name, number: about.number, finding: number })}`);
      const told = await answer.json();
      if (!answer.ok) throw new Error(told.words);
      const { lane: episode, shown } = recorded(told);
      place.replaceChildren(episode);
      shown.start();
      said.textContent = "";
    } catch (error) {
      said.textContent = error.message;
    }
    made.disabled = false;
  });
  return make("div", "", make("span", "asking", made, said), place);
}
