/* What the scripts of this page share: the loaded data, the address, and elements made of text. */
const info = JSON.parse(document.getElementById("info").textContent);
const live = "live" in document.body.dataset;
const NAME = 0, VERDICT = 1, WAY = 2, CODES = 3, STEPS = 4, SECONDS = 5, LINES = 6, PICTURE = 7, ABOUT = 8, FACETS = 9;
const byId = (id) => document.getElementById(id);
const count = (value) => value.toLocaleString("en");
const plural = (value, noun) => `${count(value)} ${noun}${value === 1 ? "" : "s"}`;

/* Loaded data: all rows and words, and the details of the last few environments. A page that is opened as a file can
   load nothing but scripts. */
const KEPT = 8;
const taken = new Map();
const waiting = new Map();
window.envcraft = (kind, number, data) => waiting.get(`${kind}-${number}`)?.(data);

function load(kind, number) {
  const key = `${kind}-${number}`;
  if (!taken.has(key)) {
    taken.set(key, new Promise((resolve, reject) => {
      const script = document.createElement("script");
      waiting.set(key, resolve);
      script.onload = () => { script.remove(); waiting.delete(key); };
      script.onerror = () => { script.remove(); taken.delete(key); reject(new Error(`data/${key}.js cannot be read`)); };
      script.src = `data/${key}.js`;
      document.head.append(script);
    }));
    const about = [...taken.keys()].filter((name) => name.startsWith("about-"));
    if (about.length > KEPT) taken.delete(about[0]);
  }
  return taken.get(key);
}

/* The number of an environment by its name; environments whose names look the same also have a number in their address. */
const numbers = new Map();

async function rowsPart(number) {
  const rows = await load("rows", number);
  rows.forEach((row, place) => { if (!numbers.has(row[NAME])) numbers.set(row[NAME], number * info.size + place); });
  return rows;
}

async function rowsOf(first, last) {
  const parts = [];
  for (let at = Math.floor(first / info.size); at * info.size < last; at++) parts.push(rowsPart(at));
  const start = Math.floor(first / info.size) * info.size;
  return (await Promise.all(parts)).flat().map((row, place) => [start + place, row]).slice(first - start, last - start);
}

async function numberOf(wanted) {
  const name = wanted.get("environment"), given = Number.parseInt(wanted.get("number"), 10);
  if (name === null) return null;
  if (given >= 0 && given < info.total && (await rowsOf(given, given + 1))[0][1][NAME] === name) return given;
  if (!numbers.has(name)) await rowsOf(0, info.total);
  return numbers.get(name) ?? -1;
}

const addressOf = (number, name) => ({
  environment: name, number: numbers.has(name) && numbers.get(name) !== number ? String(number) : null,
});

/* The address holds what is shown, so that going back and links work. */
const state = () => new URLSearchParams(location.hash.slice(1));

function go(changes, replace) {
  const next = state();
  for (const [key, value] of Object.entries(changes)) value ? next.set(key, value) : next.delete(key);
  if (next.toString() === state().toString()) return;
  if (!replace) { location.hash = next.toString(); return; }
  history.replaceState(null, "", `#${next}`);
  show();
}

function linked(text, changes) {
  const next = state();
  for (const [key, value] of Object.entries(changes)) value === null ? next.delete(key) : next.set(key, value);
  const made = make("a", "", text);
  made.href = `#${next}`;
  return made;
}

function make(tag, classes, ...children) {
  const made = document.createElement(tag);
  if (classes) made.className = classes;
  // Long ones scroll, also by keyboard.
  if (tag === "pre") made.tabIndex = 0;
  made.append(...children.filter((child) => child !== null && child !== undefined && child !== ""));
  return made;
}

function button(text, act, title) {
  const made = make("button", "", text);
  made.type = "button";
  if (title) made.title = title;
  // A sign has no name of its own.
  if (title && text.length === 1) made.setAttribute("aria-label", title);
  made.addEventListener("click", act);
  return made;
}

const pictureOf = (number) => `media/${Math.floor(number / info.folder)}/${number}.webp`;

function film(number, row) {
  if (!row[PICTURE]) return make("span", "film none");
  const image = make("img", "film");
  Object.assign(image, { loading: "lazy", width: 84, height: 84, alt: "" });
  image.src = pictureOf(number);
  return image;
}

const verdictOf = (row) => info.verdicts[row[VERDICT]];

const badge = (row) => make("span", `verdict ${verdictOf(row)}`, info.words[verdictOf(row)] ?? verdictOf(row));

const coded = (text) => text.split("`").map((words, place) => (place % 2 ? make("code", "", words) : words));
