"""Writes the site: two pages with their style and scripts in them, and what the second one loads while it is read."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from envcraft import __version__
from envcraft.check import Check, Rule
from envcraft.corpus.report import charts, media, tables
from envcraft.corpus.report.alike import Alike, alike
from envcraft.corpus.report.chunks import ROWS, Chunks
from envcraft.corpus.report.data import FAR, TIMES, Entry, Survey, entries
from envcraft.corpus.report.players import player_rows
from envcraft.corpus.report.swap import replaced
from envcraft.corpus.store import Store, now
from envcraft.reports import Numbered, one_line, printable, replay_command
from envcraft.stats import Proportion
from envcraft.verdict import CheckReport, Finding, Report, Severity, plain

TEMPLATES = Path(__file__).with_name("templates")
#: So many pictures are on the first page, and so many rows in its lists.
_SHEET, _SLOWEST, _OUTLIERS, _CLUSTERS, _MEMBERS = 24, 10, 20, 10, 6
#: Pictures in one folder.
_FOLDER = 500
_WORDS = {"pass": "passed", "fail": "failed", "error": "not judged", "none": "no verdict", "skip": "skipped"}
_SETTINGS = ("contract", "budget", "seed", "driver", "rules", "image")


class Site:
    """One report, written to `folder`.

    Attributes:
        checks: every check that there is, in the order in which they run.
        files: what the names of environments are below, where the corpus follows a folder.
    """

    def __init__(self, store: Store, folder: Path, checks: Sequence[Check], files: str = "") -> None:
        self.store, self.folder, self.files = store, folder, files
        self.rules: dict[str, Rule] = {rule.code: rule for check in checks for rule in check.rules}
        self.survey = Survey(check.name for check in checks)
        self.settings = _settings(store)
        self.players = player_rows(store)
        self._pictured = array("l")
        self._passed = array("l")

    def write(self, notes: Sequence[str] = ()) -> None:
        """Write everything; `notes` are said on the first page. Raises CorpusDamaged, OSError."""
        copies = alike(self.store)
        chunks = Chunks(self.folder / "data", self.rules)
        with tables.Tables(self.folder) as written:
            for entry in entries(self.store):
                source = self.store.source(entry.environment.source)
                lines = source.count(b"\n") + (not source.endswith(b"\n"))
                self.survey.take(entry, lines)
                written.add(entry, lines, copies.cluster(entry.number))
                others = [(number, one_line(name)) for number, name in copies.others(entry.number)]
                chunks.add(entry, source, lines, self._command(entry), self._picture(entry), others)
        chunks.end()
        main = self.survey.settings.most_common(1)
        settings = self.settings[main[0][0]] if main else {}
        told = {"corpus": self._title(), "made": now(), "settings": settings}
        likeness = {"layers": copies.layers, "clusters": [cluster for cluster, _ in copies.clusters]}
        tables.write_summary(self.folder, self.survey, self.rules, {**told, **likeness})
        self._pages(chunks, told, copies, notes)

    def _title(self) -> str:
        return one_line(self.files or self.store.root.name)

    def _picture(self, entry: Entry) -> bool:
        """Copy an environment's preview, and say whether there is one."""
        file = media.preview(self.store, entry.environment)
        if file is None:
            return False
        place = self.folder / _picture(entry.number)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, place)
        (self._passed if entry.verdict == "pass" else self._pictured).append(entry.number)
        return True

    def _command(self, entry: Entry) -> str:
        """What to type to judge an environment again, as it was judged."""
        if entry.report is None or entry.settings is None:
            return ""
        told = self.settings[entry.settings]
        path = f"{self.files}/{entry.name}" if self.files else str(self.store.place(entry.environment.source))
        subject = msgspec.structs.replace(entry.report, path=path)
        report = Report(told["contract"], told["seed"], [subject], budget=told["budget"])
        item = Numbered(1, 1, 0, subject, CheckReport("", subject.verdict), Finding("", Severity.ERROR, ""))
        words = replay_command(report, item).splitlines()[0]
        picked = entry.environment.env_class
        return printable(f"{words} --class {picked}" if picked.isidentifier() else words)

    # Pages

    def _pages(self, chunks: Chunks, told: dict[str, Any], copies: Alike, notes: Sequence[str]) -> None:
        survey = self.survey
        verdicts = [(word, survey.verdicts[word]) for word in _WORDS if survey.verdicts[word]]
        common = {
            **told,
            "survey": survey,
            "version": __version__,
            "words": _WORDS,
            "verdicts": verdicts,
            "rules": self.rules,
        }
        listed = {
            "total": survey.total,
            "size": ROWS,
            "folder": _FOLDER,
            "verdicts": chunks.verdicts.words,
            "checks": chunks.checks.words,
            "codes": [
                [code, self.rules[code].name if code in self.rules else "", code in self.rules]
                for code in chunks.codes.words
            ],
            "words": _WORDS,
        }
        pages = Pages()
        pages.write(
            self.folder / "environments.html", "environments.html", ("film.js", "list.js"), **common, info=_data(listed)
        )
        pages.write(
            self.folder / "index.html",
            "index.html",
            ("film.js",),
            **common,
            **self._figures(),
            notes=notes,
            players=self.players,
            others=sum(survey.settings.values()) - max(survey.settings.values(), default=0),
            sheet=[(number, survey.names[number], _picture(number)) for number in self._sheet()],
            slowest=[(number, survey.names[number], value) for number, value in survey.measures[0].highest(_SLOWEST)],
            outliers=survey.outliers(),
            shown=_OUTLIERS,
            drawn=charts.CODES,
            copies=copies,
            clusters=[
                (cluster, len(numbers), [(number, self._shown(number)) for number in numbers[:_MEMBERS]])
                for cluster, numbers in copies.clusters[:_CLUSTERS]
            ],
            far=FAR,
            times=TIMES,
        )

    def _figures(self) -> dict[str, Any]:
        survey = self.survey
        drawn = {"players": charts.players(self.players)} if self.players else {}
        if not survey.judged:
            return {"charts": drawn}
        drawn |= {
            "cascade": charts.cascade(survey.stages(), survey.judged),
            "checks": charts.checks(survey.checks()),
            "spread": charts.distributions(survey.measures[:3]),
        }
        if survey.codes():
            drawn["codes"] = charts.codes(survey.codes(), survey.judged)
        if survey.attempts():
            drawn["yields"] = charts.yields(survey.attempts())
        return {"charts": drawn}

    def _shown(self, number: int) -> str:
        """Where an environment's picture lies, if it has one."""
        place = _picture(number)
        return place if (self.folder / place).exists() else ""

    def _sheet(self) -> list[int]:
        """Whose pictures are on the first page, from all over the corpus: environments that pass, if any do."""
        numbers = self._passed or self._pictured
        count = min(_SHEET, len(numbers))
        return [numbers[place * len(numbers) // count] for place in range(count)]


class Pages:
    """The templates, and what every page has."""

    def __init__(self) -> None:
        import jinja2

        self._environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(TEMPLATES),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self._environment.filters |= {
            "count": lambda value: f"{value:,}",
            "number": number,
            "share": lambda value: f"{value:.1%}",
            "interval": interval,
            "one_line": one_line,
            "times": times,
        }

    def write(self, path: Path, template: str, scripts: Sequence[str], **values: Any) -> None:
        """Render a page whose scripts are those of these files, and let it run nothing else."""
        style = _text("palette.css", Path(__file__).parents[2] / "reports") + _text("style.css")
        script = "".join(map(_text, scripts))
        policy = (
            f"default-src 'none'; img-src 'self' file: data:; style-src '{_digest(style)}'; "
            # What a script loads is its own doing; nothing else is let in.
            f"script-src '{_digest(script)}' 'strict-dynamic'; base-uri 'none'; form-action 'none'"
        )
        page = self._environment.get_template(template).render(style=style, script=script, policy=policy, **values)
        path.write_text(printable(page), "utf-8")


def build(store: Store, output: Path, checks: Sequence[Check], files: str = "", notes: Sequence[str] = ()) -> Survey:
    """Write the report on `store` in place of one that there may be; give what was counted.

    Raises UsageError where it cannot be written, CorpusDamaged.
    """
    with replaced(output) as folder:
        site = Site(store, folder, checks, files)
        site.write(notes)
        return site.survey


def number(value: float) -> str:
    """Three digits or so: ``0.042``, ``3.14``, ``1,250``."""
    if value >= 100 or value == int(value):
        return f"{value:,.0f}"
    return f"{value:.1f}" if value >= 10 else f"{value:.3g}"


def times(ratio: float) -> str:
    """A ratio as a factor, and as a fraction where it is small, like ``1/64``."""
    if ratio < 0.1:
        return f"1/{1 / ratio:,.0f}"
    return f"{number(ratio) if ratio >= 1 else f'{ratio:.2f}'}\N{MULTIPLICATION SIGN}"


def interval(rate: Proportion) -> str:
    """``96.1 - 97.9%``, with a dash."""
    return f"{100 * rate.low:.1f}\N{EN DASH}{100 * rate.high:.1f}%" if rate.n else ""


def _picture(place: int) -> str:
    return f"media/{place // _FOLDER}/{place}.webp"


def _settings(store: Store) -> dict[int, dict[str, Any]]:
    rows = store.db.execute(f"SELECT id, {', '.join(_SETTINGS)} FROM settings")
    return {row[0]: dict(zip(_SETTINGS, row[1:], strict=True)) for row in rows}


def _text(name: str, folder: Path = TEMPLATES) -> str:
    return (folder / name).read_text("utf-8")


def _data(value: Any) -> str:
    """JSON that no HTML parser takes for the end of a script."""
    return json.dumps(plain(value)).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _digest(text: str) -> str:
    """What the content security policy allows to run or to style."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
