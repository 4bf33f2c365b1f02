const info = JSON.parse(document.getElementById("info").textContent);
const PAGE = 50;
const FIELDS = ["query", "verdict", "check", "code", "sort"];
const NAME = 0, VERDICT = 1, FAILED = 2, CODES = 3, STEPS = 4, SECONDS = 5, LINES = 6, PICTURE = 7, ABOUT = 8;
const ORDERS = {
  seconds: (row) => row[SECONDS],
  steps: (row) => row[STEPS],
  speed: (row) => (row[SECONDS] ? row[STEPS] / row[SECONDS] : 0),
  lines: (row) => row[LINES],
};
const byId = (id) => document.getElementById(id);
const count = (value) => value.toLocaleString("en");
const plural = (value, noun) => `${count(value)} ${noun}${value === 1 ? "" : "s"}`;

/* What is loaded: rows are kept, the last few scripts about environments, too. */
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
    if (about.length > 8) taken.delete(about[0]);
  }
  return taken.get(key);
}

async function rowsOf(first, last) {
  const parts = [];
  for (let part = Math.floor(first / info.size); part * info.size < last; part++) parts.push(load("rows", part));
  const start = Math.floor(first / info.size) * info.size;
  return (await Promise.all(parts)).flat().map((row, place) => [start + place, row]).slice(first - start, last - start);
}

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

function make(tag, classes, ...children) {
  const made = document.createElement(tag);
  if (classes) made.className = classes;
  made.append(...children.filter((child) => child !== null && child !== ""));
  return made;
}

function linked(text, changes) {
  const next = state();
  for (const [key, value] of Object.entries(changes)) value === null ? next.delete(key) : next.set(key, value);
  const made = make("a", "", text);
  made.href = `#${next}`;
  return made;
}

function film(number, row) {
  if (!row[PICTURE]) return make("span", "film none");
  const image = make("img", "film");
  Object.assign(image, { loading: "lazy", width: 84, height: 84, alt: "" });
  image.src = `media/${Math.floor(number / info.folder)}/${number}.webp`;
  return image;
}

const verdictOf = (row) => info.verdicts[row[VERDICT]];
const badge = (verdict) => make("span", `verdict ${verdict}`, info.words[verdict] ?? verdict);

function item(number, row) {
  const link = linked("", { show: number });
  const codes = row[CODES].map((code) => info.codes[code][0]).join(" ");
  const told = row[SECONDS] ? `${plural(row[STEPS], "step")}, ${row[SECONDS].toFixed(1)} s` : "";
  link.append(film(number, row), make("span", "name", row[NAME]), badge(verdictOf(row)), make("span", "codes", codes),
    make("span", "soft", told));
  return make("li", "", link);
}

async function matching(wanted) {
  const words = (wanted.get("query") ?? "").toLowerCase().split(/\s+/).filter(Boolean);
  const [verdict, check, code] = ["verdict", "check", "code"].map((key) => wanted.get(key));
  const failed = info.checks.indexOf(check), has = info.codes.findIndex((known) => known[0] === code);
  const fits = ([, row]) => {
    if (verdict && verdictOf(row) !== verdict) return false;
    if (check && !row[FAILED].includes(failed)) return false;
    if (code && !row[CODES].includes(has)) return false;
    const text = words.length ? `${row[NAME]} ${row[CODES].map((known) => info.codes[known][0]).join(" ")}`.toLowerCase() : "";
    return words.every((word) => text.includes(word));
  };
  const found = (await rowsOf(0, info.total)).filter(fits);
  const order = wanted.get("sort") ?? "", value = ORDERS[order.replace("-", "")];
  if (value) {
    const sign = order.startsWith("-") ? -1 : 1;
    found.sort(([a, one], [b, other]) => sign * (value(one) - value(other)) || a - b);
  }
  return found;
}

/* Only what is on the page is loaded while nothing is looked for. */
const looking = (wanted) => FIELDS.some((field) => wanted.get(field));
let turn = 0;

async function list(wanted) {
  const mine = ++turn;
  let page = Math.max(Math.trunc(Number(wanted.get("page"))) || 1, 1);
  const found = looking(wanted) ? await matching(wanted) : null;
  const total = found ? found.length : info.total;
  const pages = Math.max(Math.ceil(total / PAGE), 1);
  page = Math.min(page, pages);
  const from = (page - 1) * PAGE, to = Math.min(from + PAGE, total);
  const rows = found ? found.slice(from, to) : await rowsOf(from, to);
  if (mine !== turn) return;
  for (const field of FIELDS) if (byId(field) !== document.activeElement) byId(field).value = wanted.get(field) ?? "";
  byId("rows").replaceChildren(...rows.map(([number, row]) => item(number, row)));
  byId("rows").start = from + 1;
  byId("shown").textContent = found ? `${count(total)} of ${count(info.total)}` : plural(total, "environment");
  byId("page").textContent = `${count(page)} of ${count(pages)}`;
  byId("pager").hidden = pages < 2;
  byId("back").disabled = page <= 1;
  byId("on").disabled = page >= pages;
}

function pairs(entries) {
  return make("dl", "facts", ...entries.filter(([, value]) => value).map(([key, value]) =>
    make("div", "", make("dt", "", key), make("dd", "", value))));
}

function unfolded(title, ...content) {
  return make("details", "", make("summary", "", title), ...content);
}

function finding(found, about, number) {
  const kind = found.severity === "warning" ? "warning" : "fail";
  const place = found.line ? make("a", "", `line ${found.line}`) : null;
  if (place) {
    place.href = "#";
    place.addEventListener("click", (event) => {
      event.preventDefault();
      byId(`line-${found.line}`)?.scrollIntoView({ block: "center" });
      byId(`line-${found.line}`)?.focus({ preventScroll: true });
    });
  }
  const head = make("h3", "", make("span", kind, found.code), make("span", "", found.name),
    kind === "warning" ? make("span", "soft", "warning") : null, make("span", "soft", found.check), place);
  const replay = `${about.command}\nenvcraft replay report.json --finding ${number}`;
  const evidence = found.evidence.map(([key, value]) => make("div", "", make("b", "", key), make("pre", "", value)));
  return make("section", "finding", head, make("p", "message", found.message),
    found.fix ? make("p", "", ...coded(found.fix)) : null,
    evidence.length ? unfolded("Evidence", ...evidence) : null,
    about.command ? unfolded(`Reproduction: ${found.repro}`, make("pre", "command", replay)) : null);
}

const coded = (text) => text.split("`").map((part, place) => (place % 2 ? make("code", "", part) : part));

function source(about) {
  const marked = new Map(about.findings.filter((found) => found.line).map((found) => [found.line, found]));
  const lines = about.source.split("\n");
  if (lines.at(-1) === "") lines.pop();
  const body = make("ol", "source");
  body.append(...lines.map((text, place) => {
    const found = marked.get(place + 1);
    const line = make("li", found ? (found.severity === "warning" ? "marked warning" : "marked fail") : "", make("code", "", text || " "));
    if (found) {
      line.id = `line-${place + 1}`;
      line.tabIndex = -1;
      line.title = `${found.code} ${found.message}`;
    }
    return line;
  }));
  return make("section", "code", make("h2", "", "Source"), body, about.cut ? make("p", "soft", "The rest is not shown.") : null);
}

async function one(wanted, number) {
  const mine = ++turn;
  const [[, row]] = await rowsOf(number, number + 1);
  const about = (await load("about", row[ABOUT])).find((told) => told.number === number);
  if (mine !== turn || !about) return;
  const title = make("h1", "", about.name);
  title.tabIndex = -1;
  const picture = film(number, row);
  const shown = row[PICTURE] ? make("div", "screen", picture) : null;
  if (row[PICTURE]) {
    picture.alt = "Random play, with held actions";
    picture.dataset.kept = "1";
    const button = make("button", "", "Play");
    button.type = "button";
    const set = (on) => { on ? play(picture) : stop(picture); button.textContent = films.has(picture) ? "Pause" : "Play"; };
    button.addEventListener("click", () => set(!films.has(picture)));
    picture.addEventListener("load", () => set(!still.matches));
    shown.append(button);
  }
  const checks = about.checks.map(([name, verdict, seconds, reason]) => make("li", "", badge2(verdict),
    make("span", "", name), make("span", "time", `${seconds.toFixed(2)} s`), make("span", "reason soft", reason)));
  const facts = pairs([["class", about.class], ["steps", row[STEPS] ? count(row[STEPS]) : ""],
    ["time", row[SECONDS] ? `${row[SECONDS].toFixed(1)} s` : ""], ["lines", count(row[LINES])],
    ["isolation", about.isolation], ["added", about.added.slice(0, 10)], ["source", about.sha256.slice(0, 12)],
    ...about.origin]);
  const duplicates = about.duplicates.map(([other, name]) => make("li", "", linked(name, { show: other })));
  const way = make("nav", "way", linked("All environments", { show: null }));
  way.setAttribute("aria-label", "Environments");
  if (number > 0) way.append(linked("Previous", { show: number - 1 }));
  if (number < info.total - 1) way.append(linked("Next", { show: number + 1 }));
  byId("one").replaceChildren(way,
    make("div", shown ? "head pictured" : "head", shown, make("div", "", badge(verdictOf(row)), title, facts,
      about.reason ? make("p", "message", about.reason) : null, make("ul", "checks", ...checks))),
    ...about.findings.map((found, place) => finding(found, about, place + 1)),
    ...(duplicates.length ? [make("section", "duplicates", make("h2", "", "Duplicates"), make("ul", "", ...duplicates))] : []),
    source(about));
  document.title = about.name;
  scrollTo(0, 0);
  title.focus({ preventScroll: true });
}

const badge2 = (verdict) => make("span", `verdict ${verdict}`, verdict);
let place = 0;

async function show() {
  const wanted = state();
  const number = Number.parseInt(wanted.get("show"), 10);
  const single = number >= 0 && number < info.total;
  const before = !byId("one").hidden;
  if (single && !before) place = scrollY;
  byId("browse").hidden = single;
  byId("one").hidden = !single;
  try {
    await (single ? one(wanted, number) : list(wanted));
  } catch (error) {
    byId("browse").hidden = false;
    byId("one").hidden = true;
    byId("shown").textContent = `${error.message}: the report's folder is not whole`;
    return;
  }
  if (!single) {
    document.title = "Environments";
    if (before) scrollTo(0, place);
  }
}

document.querySelector(".filter").addEventListener("submit", (event) => event.preventDefault());
let pause = 0;
for (const field of FIELDS) {
  byId(field).addEventListener("input", () => {
    clearTimeout(pause);
    // All of them: what was typed a moment ago may not have been taken yet.
    const changes = () => ({ ...Object.fromEntries(FIELDS.map((name) => [name, byId(name).value])), page: "" });
    pause = setTimeout(() => go(changes(), true), field === "query" ? 120 : 0);
  });
}
for (const [id, by] of [["back", -1], ["on", 1]]) {
  byId(id).addEventListener("click", () => {
    go({ page: (Number(state().get("page")) || 1) + by });
    scrollTo(0, 0);
  });
}
document.addEventListener("keydown", (event) => {
  if (event.key === "/" && !byId("browse").hidden && !event.target.matches("input, select")) {
    event.preventDefault();
    byId("query").focus();
  }
});
addEventListener("hashchange", show);
show();
