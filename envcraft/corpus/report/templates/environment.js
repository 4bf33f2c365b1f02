/* The page of one environment. All text of an environment is shown as text, never as markup. */
function pairs(entries) {
  return make("dl", "facts", ...entries.filter(([, value]) => value).map(([key, value]) =>
    make("div", "", make("dt", "", key), make("dd", "", value))));
}

const unfolded = (title, ...content) => make("details", "", make("summary", "", title), ...content);

function part(id, title, ...content) {
  const made = make("section", `part ${id}`, make("h2", "", title), ...content);
  made.id = `part-${id}`;
  return made;
}

function copied(text) {
  const copy = button("Copy", async () => {
    await navigator.clipboard.writeText(text);
    copy.textContent = "Copied";
  });
  return make("div", "copied", make("pre", "command", text), copy);
}

function toLine(number) {
  const link = make("a", "", `line ${number}`);
  link.href = "#";
  link.addEventListener("click", (event) => {
    event.preventDefault();
    byId(`line-${number}`)?.scrollIntoView({ block: "center" });
    byId(`line-${number}`)?.focus({ preventScroll: true });
  });
  return link;
}

function finding(found, about, number) {
  const kind = found.severity === "warning" ? "warning" : "fail";
  const head = make("h3", "", make("span", kind, found.code), make("span", "", found.name),
    kind === "warning" ? make("span", "soft", "warning") : null, make("span", "soft", found.check),
    found.line ? toLine(found.line) : null);
  const replay = `${about.command}\nenvcraft replay report.json --finding ${number}`;
  const evidence = found.evidence.map(([key, value]) => make("div", "", make("b", "", key), make("pre", "", value)));
  const section = make("section", "finding", head, make("p", "message", found.message),
    found.fix ? make("p", "", ...coded(found.fix)) : null,
    evidence.length ? unfolded("Evidence", ...evidence) : null,
    about.command ? unfolded(`Reproduction: ${found.repro}`, make("pre", "command", replay)) : null);
  const known = about.episodes.find((episode) => episode.finding === number);
  if (known?.omitted) section.append(make("p", "soft small", `The reproduction is not recorded: ${known.omitted}.`));
  else if (known) section.append(recorded(known).lane);
  else if (live && about.command) section.append(replayer(about, number));
  return section;
}

function source(about) {
  const marked = new Map();
  for (const found of about.findings) if (found.line) marked.set(found.line, [...(marked.get(found.line) ?? []), found]);
  const lines = about.source.split("\n");
  if (lines.at(-1) === "") lines.pop();
  const body = make("ol", "source");
  // It scrolls sideways.
  body.tabIndex = 0;
  body.setAttribute("aria-label", "Lines of the source");
  body.append(...tokens(lines.join("\n")).map((parts, place) => {
    const found = marked.get(place + 1) ?? [];
    const grave = found.some((one) => one.severity !== "warning");
    const line = make("li", found.length ? `marked ${grave ? "fail" : "warning"}` : "", coloured(parts));
    if (found.length) {
      line.id = `line-${place + 1}`;
      line.tabIndex = -1;
      line.title = found.map((one) => `${one.code} ${one.message}`).join("\n");
      line.append(...found.map((one) => make("span", "told", one.code)));
    }
    return line;
  }));
  return part("code", "Source", body, about.cut ? make("p", "soft", "The rest is not shown.") : null);
}

function story(told) {
  if (!told) return [];
  const stages = told.stages.map(([stage, result, reason]) => make("li", "", make("span", `verdict ${result === "passed" ? "pass" : "fail"}`, result),
    make("span", "", stage), make("span", "reason soft", reason)));
  const attempts = told.attempts.map((attempt) => unfolded(
    [`Attempt ${attempt.number}`, attempt.result, attempt.codes, attempt.gutted].filter(Boolean).join(" \u00b7 "),
    attempt.diff ? diff(attempt.diff) : make("p", "soft", "The first attempt, or the same source as before.")));
  const policies = told.policies.map((policy) => unfolded(
    `Policy ${policy.number}: won ${policy.wins} of ${policy.episodes}${policy.fault ? `, ${policy.fault}` : ""}`,
    make("pre", "", ...tokens(policy.source).flatMap((parts) => [coloured(parts), "\n"]))));
  return [
    part("concept", told.title || "Concept", make("p", "told-text", told.text), told.brief ? unfolded("Brief", make("pre", "brief", told.brief)) : null,
      stages.length ? make("ul", "checks", ...stages) : null),
    ...(attempts.length ? [part("attempts", "Repair history", ...attempts)] : []),
    ...(policies.length ? [part("policies", "Privileged policies", ...policies)] : []),
  ];
}

function plots(players) {
  if (!players.length) return [];
  return [part("plots", "Recorded play", spread("Return", players, "totals"), spread("Steps", players, "steps"))];
}

function duplicates(about, copies) {
  if (!copies.length) return [];
  const items = copies.map(([number, row]) => {
    const link = linked("", addressOf(number, row[NAME]));
    link.append(film(number, row), row[NAME]);
    return make("li", "", link);
  });
  return [part("duplicates", "Near-duplicates", make("p", "soft", `Alike in the layers: ${about.layers.join(", ")}.`), make("ul", "", ...items))];
}

/* Where it comes from: long values are folded. */
function lineage(about) {
  if (!about.origin.length) return [];
  const long = about.origin.filter(([, value]) => value.length > 80);
  return [part("lineage", "Lineage", pairs(about.origin.filter(([, value]) => value.length <= 80)),
    ...long.map(([key, value]) => unfolded(key, make("pre", "", value))))];
}

/* What has not passed runs in a sandbox only. */
function usage(about, row) {
  const inside = ["pass", "undecided"].includes(verdictOf(row)) ? "" : ', sandbox="auto"';
  const call = `import envcraft\n\nenv = envcraft.make(${JSON.stringify(about.corpus)}, ${JSON.stringify(about.name)}${inside})\nobservation, info = env.reset(seed=0)`;
  return part("use", "Use it from Python", copied(call));
}

async function one(wanted) {
  const mine = ++listed.turn;
  leave();
  const number = await numberOf(wanted);
  if (number < 0) {
    byId("one").replaceChildren(make("h1", "", "No such environment"), linked("All environments", { environment: null, number: null }));
    return;
  }
  const [[, row], ...around] = [...await rowsOf(number, number + 1),
    ...(number > 0 ? await rowsOf(number - 1, number) : []), ...(number < info.total - 1 ? await rowsOf(number + 1, number + 2) : [])];
  const about = (await load("about", row[ABOUT])).find((told) => told.number === number);
  const copies = about ? (await Promise.all(about.duplicates.map((other) => rowsOf(other, other + 1)))).flat() : [];
  if (mine !== listed.turn || !about) return;
  const title = make("h1", "", about.name);
  title.tabIndex = -1;
  // People would rather play than read.
  const play = live ? stage(about, row[PICTURE] ? pictureOf(number) : "") : watched(about);
  byId("one").replaceChildren(way(number, around), badge(row), title, ...play, judged(number, row, about, !play.length),
    ...(about.findings.length ? [part("findings", "Findings", ...about.findings.map((found, place) => finding(found, about, place + 1)))] : []),
    ...story(about.history), ...plots(about.players),
    ...duplicates(about, copies), ...lineage(about),
    source(about), usage(about, row),
    ...(about.record ? [part("record", "Validation record", unfolded("What was judged, how, and the result", copied(about.record)))] : []));
  document.title = about.name;
  scrollTo(0, 0);
  title.focus({ preventScroll: true });
}

/* The values of a facet, each with a link to the environments that have it. More than a few are folded. */
const FEW = 6;
const valuesOf = (facet, row) => row[FACETS][info.facets.indexOf(facet)];

function alike(facet, row) {
  const links = valuesOf(facet, row).map((word) => Object.assign(make("a", "", facet.words[word]), {
    href: `#${new URLSearchParams({ [facet.name]: facet.words[word] })}`,
  }));
  return make("span", "values", ...links);
}

function way(number, around) {
  const made = make("nav", "way", Object.assign(linked("All environments", { environment: null, number: null }), { id: "all" }));
  made.setAttribute("aria-label", "Environments");
  for (const [other, row] of around) {
    const before = other < number;
    made.append(Object.assign(linked(before ? "Previous" : "Next", addressOf(other, row[NAME])), { id: before ? "previous" : "next" }));
  }
  return made;
}

/* What was judged, with the preview where nothing else moves. */
function judged(number, row, about, previewed) {
  const picture = film(number, row);
  const shown = previewed && row[PICTURE] ? make("div", "preview", picture) : null;
  if (shown) {
    picture.alt = "Random play, with held actions";
    picture.dataset.kept = "1";
    const toggle = button("Play preview", () => set(!films.has(picture)));
    const set = (on) => { on ? play(picture) : stop(picture); toggle.textContent = films.has(picture) ? "Pause preview" : "Play preview"; };
    picture.addEventListener("load", () => set(!still.matches));
    shown.append(make("div", "controls", toggle));
  }
  const known = info.facets.filter((_, place) => row[FACETS][place].length);
  const [short, long] = [false, true].map((many) => known.filter((facet) => (valuesOf(facet, row).length > FEW) === many));
  const facets = short.map((facet) => [facet.label.toLowerCase(), alike(facet, row)]);
  const facts = pairs([["class", about.class], ["steps", row[STEPS] ? count(row[STEPS]) : ""],
    ["time", row[SECONDS] ? `${row[SECONDS].toFixed(1)} s` : ""], ["lines", count(row[LINES])],
    ["isolation", about.isolation], ["added", about.added.slice(0, 10)], ["source", about.sha256.slice(0, 12)], ...facets]);
  const checks = about.checks.map(([name, verdict, seconds, reason]) => make("li", "", make("span", `verdict ${verdict}`, verdict),
    make("span", "", name), make("span", "time", `${seconds.toFixed(2)} s`), make("span", "reason soft", reason)));
  return part("judged", "Verdict", make("div", shown ? "pictured" : "", shown, make("div", "", facts,
    ...long.map((facet) => unfolded(plural(valuesOf(facet, row).length, facet.label.toLowerCase()), alike(facet, row))),
    about.reason ? make("p", "message", about.reason) : null, make("ul", "checks", ...checks))));
}

/* Recorded episodes, where no server plays. */
function watched(about) {
  const episodes = about.episodes.filter((episode) => !episode.finding);
  if (!episodes.length) return [];
  const side = lanes(episodes.filter((episode) => !episode.omitted));
  const missing = episodes.filter((episode) => episode.omitted).map(({ label, omitted }) => make("p", "soft small", `Not recorded: ${label}, ${omitted}.`));
  return [part("watch", "Recorded episodes", episodes.length > 1 ? make("p", "controls", side.together) : null, side.row, ...missing)];
}
