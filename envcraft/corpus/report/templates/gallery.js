/* The gallery: search, facets and order in the browser. Only the cards in sight exist. */
const FACET_FIELDS = info.facets.map((facet) => facet.name).filter((name) => byId(name));
const FIELDS = ["query", "verdict", "check", "code", ...FACET_FIELDS, "sort"];
const ORDERS = {
  seconds: (row) => row[SECONDS],
  steps: (row) => row[STEPS],
  speed: (row) => (row[SECONDS] ? row[STEPS] / row[SECONDS] : 0),
  lines: (row) => row[LINES],
};
const LETTERS = 2, TEXT = 68, GAP = 16, NARROWEST = 148, SPARE = 2;

/* Environments with a word that starts with the typed letters, in their source, concept or brief. */
async function withWord(word) {
  const found = new Set();
  const key = word.slice(0, LETTERS);
  if (!info.parts.includes(key)) return found;
  for (const [known, gaps] of Object.entries(await load("words", key))) {
    if (!known.startsWith(word)) continue;
    let number = 0;
    for (const gap of gaps) found.add(number += gap);
  }
  return found;
}

async function matching(wanted) {
  const words = (wanted.get("query") ?? "").toLowerCase().split(/\s+/).filter(Boolean);
  const indexed = await Promise.all(words.map((word) => (/^[a-z0-9_]{2,40}$/.test(word) ? withWord(word) : new Set())));
  const [verdict, check, code] = ["verdict", "check", "code"].map((key) => wanted.get(key));
  // A check alone means that it failed; `check:undecided` names another outcome.
  const [judge, outcome = "fail"] = (check ?? "").split(":");
  const ways = info.ways.map((way) => way[judge] === outcome);
  const has = info.codes.findIndex((known) => known[0] === code);
  const facets = info.facets.map((facet, place) => [place, wanted.get(facet.name), facet])
    .filter(([, value]) => value).map(([place, value, facet]) => [place, facet.words.indexOf(value)]);
  const fits = ([number, row]) => {
    if (verdict && verdictOf(row) !== verdict) return false;
    if (check && !ways[row[WAY]]) return false;
    if (code && !row[CODES].includes(has)) return false;
    if (!facets.every(([place, value]) => row[FACETS][place].includes(value))) return false;
    const text = words.length ? `${row[NAME]} ${row[CODES].map((known) => info.codes[known][0]).join(" ")}`.toLowerCase() : "";
    return words.every((word, place) => text.includes(word) || indexed[place].has(number));
  };
  const found = (await rowsOf(0, info.total)).filter(fits);
  const order = wanted.get("sort") ?? "", value = ORDERS[order.replace("-", "")];
  if (value) {
    const sign = order.startsWith("-") ? -1 : 1;
    found.sort(([a, one], [b, other]) => sign * (value(one) - value(other)) || a - b);
  }
  return found;
}

/* What is listed: all environments, whose rows are loaded when they come into sight, or those that were found. */
const listed = { total: info.total, found: null, cards: new Map(), at: 0, turn: 0 };

const slice = async (from, to) => (listed.found ? listed.found.slice(from, to) : rowsOf(from, to));

function grid() {
  const width = byId("rows").clientWidth;
  const columns = Math.max(Math.floor((width + GAP) / (NARROWEST + GAP)), 1);
  const side = (width - GAP * (columns - 1)) / columns;
  return { columns, side, height: side + TEXT + GAP };
}

function card(place, number, row) {
  const link = linked("", addressOf(number, row[NAME]));
  const codes = row[CODES].map((code) => info.codes[code][0]).join(" ");
  link.append(film(number, row), make("span", "name", row[NAME]), badge(row), make("span", "codes", codes));
  link.dataset.place = place;
  const item = make("li", "", link);
  item.setAttribute("aria-setsize", listed.total);
  item.setAttribute("aria-posinset", place + 1);
  return item;
}

async function draw() {
  const list = byId("rows"), { columns, side, height } = grid();
  const lines = Math.ceil(listed.total / columns);
  list.style.height = `${Math.max(lines * height - GAP, 0)}px`;
  const top = -list.getBoundingClientRect().top;
  const first = Math.max(Math.floor(top / height) - SPARE, 0);
  const last = Math.min(Math.ceil((top + innerHeight) / height) + SPARE, lines);
  const [from, to] = [first * columns, Math.min(Math.max(last, 0) * columns, listed.total)];
  const mine = listed.turn;
  const rows = await slice(from, to);
  if (mine !== listed.turn) return;
  const kept = new Map();
  for (const [offset, [number, row]] of rows.entries()) {
    const place = from + offset;
    const item = listed.cards.get(place) ?? card(place, number, row);
    item.style.width = `${side}px`;
    item.style.transform = `translate(${(place % columns) * (side + GAP)}px, ${Math.floor(place / columns) * height}px)`;
    kept.set(place, item);
  }
  const focused = document.activeElement?.closest?.("#rows li");
  for (const [place, item] of listed.cards) if (!kept.has(place) && item !== focused) item.remove();
  // In the order of the list, which is that of the Tab key.
  let before = null;
  for (const item of kept.values()) {
    const after = before ? before.nextElementSibling : list.firstElementChild;
    if (after !== item) list.insertBefore(item, after);
    before = item;
  }
  listed.cards = kept;
}

const looking = (wanted) => FIELDS.some((field) => wanted.get(field));

async function list(wanted) {
  const mine = ++listed.turn;
  byId("rows").setAttribute("aria-busy", "true");
  const found = looking(wanted) ? await matching(wanted) : null;
  if (mine !== listed.turn) return;
  for (const field of FIELDS) if (byId(field) !== document.activeElement) byId(field).value = wanted.get(field) ?? "";
  listed.found = found;
  listed.total = found ? found.length : info.total;
  for (const item of listed.cards.values()) item.remove();
  listed.cards = new Map();
  byId("shown").textContent = found ? `${count(listed.total)} of ${count(info.total)}` : plural(info.total, "environment");
  await draw();
  byId("rows").setAttribute("aria-busy", "false");
}

/* The arrows move between cards. */
async function move(by) {
  const { columns, height } = grid();
  const steps = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: columns, ArrowUp: -columns };
  const at = document.activeElement?.dataset?.place;
  const place = at === undefined ? 0 : Number(at) + steps[by];
  if (place < 0 || place >= listed.total) return;
  const top = byId("rows").getBoundingClientRect().top + scrollY + Math.floor(place / columns) * height;
  if (top < scrollY || top + height > scrollY + innerHeight) scrollTo(0, top - innerHeight / 3);
  await draw();
  listed.cards.get(place)?.firstElementChild.focus({ preventScroll: true });
}

/* Pages */

async function show() {
  const wanted = state();
  const before = !byId("one").hidden;
  const single = wanted.get("environment") !== null;
  if (single && !before) listed.at = scrollY;
  byId("browse").hidden = single;
  byId("one").hidden = !single;
  try {
    if (single) {
      await one(wanted);
    } else {
      leave();
      await list(wanted);
    }
  } catch (error) {
    byId("browse").hidden = false;
    byId("one").hidden = true;
    byId("shown").textContent = `${error.message}: the folder of this site is incomplete`;
    return;
  }
  if (!single) {
    document.title = "Environments";
    if (before) {
      scrollTo(0, listed.at);
      await draw();
    }
  }
}

document.querySelector(".filter").addEventListener("submit", (event) => event.preventDefault());
let pause = 0;
for (const field of FIELDS) {
  byId(field).addEventListener("input", () => {
    clearTimeout(pause);
    // All of them: what was typed a moment ago may not have been taken yet.
    const changes = () => Object.fromEntries(FIELDS.map((name) => [name, byId(name).value]));
    pause = setTimeout(() => go(changes(), true), field === "query" ? 120 : 0);
  });
}
let drawing = 0;
for (const event of ["scroll", "resize"]) {
  addEventListener(event, () => {
    if (byId("browse").hidden || drawing) return;
    drawing = requestAnimationFrame(() => { drawing = 0; draw().catch(() => {}); });
  }, { passive: true });
}
document.addEventListener("keydown", (event) => {
  if (event.target.matches("input, select, textarea, summary") || event.ctrlKey || event.metaKey || event.altKey) return;
  if (byId("browse").hidden) {
    const way = { "[": "#previous", "]": "#next", Escape: "#all" }[event.key];
    if (way && !event.defaultPrevented) document.querySelector(way)?.click();
  } else if (event.key === "/") {
    event.preventDefault();
    byId("query").focus();
  } else if (event.key.startsWith("Arrow")) {
    event.preventDefault();
    move(event.key).catch(() => {});
  }
});
addEventListener("hashchange", show);
show();
