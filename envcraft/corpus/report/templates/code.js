/* Python in colours: each line of a source becomes a list of [kind, text]. */
const WORDS = new Set(("False None True and as assert async await break class continue def del elif else except finally for from "
  + "global if import in is lambda nonlocal not or pass raise return try while with yield match case self").split(" "));
const TOKEN = /(#.*)|([rRbBuUfF]{0,2}(?:"""|'''))|([rRbBuUfF]{0,2}"(?:\\.|[^"\\])*"?|[rRbBuUfF]{0,2}'(?:\\.|[^'\\])*'?)|(\b\d[\w.]*)|(@[\w.]+)|([A-Za-z_]\w*)/g;

function tokens(text) {
  let quote = "";
  return text.split("\n").map((line) => {
    const parts = [];
    let at = 0;
    const take = (kind, to) => { if (to > at) parts.push([kind, line.slice(at, to)]); at = Math.max(at, to); };
    while (at < line.length) {
      if (quote) {
        const end = line.indexOf(quote, at);
        take("text", end < 0 ? line.length : end + 3);
        if (end >= 0) quote = "";
        continue;
      }
      TOKEN.lastIndex = at;
      const found = TOKEN.exec(line);
      if (!found) { take("", line.length); break; }
      take("", found.index);
      const end = found.index + found[0].length;
      if (found[1]) take("comment", end);
      else if (found[2]) { quote = found[2].slice(-3); take("text", end); }
      else if (found[3]) take("text", end);
      else if (found[4]) take("figure", end);
      else if (found[5]) take("mark", end);
      else take(WORDS.has(found[6]) ? "word" : "", end);
    }
    return parts;
  });
}

const coloured = (parts) => make("code", "", ...(parts.length ? parts.map(([kind, text]) => (kind ? make("span", `t-${kind}`, text) : text)) : [" "]));

function diff(text) {
  const kind = (line) => ({ "+": "added", "-": "removed", "@": "place" })[line[0]] ?? "";
  return make("pre", "diff", ...text.split("\n").map((line) => make("span", kind(line), `${line}\n`)));
}
