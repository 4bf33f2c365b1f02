"""The site: two pages with their own style and scripts, and the data that the second page loads."""

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

from envcraft.corpus.report import charts, media, tables
from envcraft.corpus.report.chunks import ROWS, Chunks
from envcraft.corpus.report.data import FAR, TIMES, Entry, Survey, entries
from envcraft.corpus.report.duplicates import DuplicateSummary, summarise
from envcraft.corpus.report.output import replaced
from envcraft.corpus.report.players import player_rows
from envcraft.corpus.shared import Shared, shared_codes
from envcraft.corpus.store import Store, now, verdicts
from envcraft.judging.check import Check, Rule
from envcraft.judging.statistics import Proportion
from envcraft.model.verdict import CheckReport, Finding, Report, Severity, plain
from envcraft.reports.summary import Numbered, replay_command
from envcraft.text import one_line, printable
from envcraft.version import __version__

TEMPLATES = Path(__file__).with_name("templates")
#: The number of previews on the first page, and of rows in its lists.
_SHEET, _SLOWEST, _OUTLIERS, _CLUSTERS, _MEMBERS = 24, 10, 20, 10, 6
#: Previews in one folder.
_FOLDER = 500
_WORDS = {"pass": "passed", "fail": "failed", "error": "not judged", "none": "no verdict", "skip": "skipped"}
_SETTINGS = ("contract", "budget", "seed", "driver", "rules", "image")


class Site:
    """One report.

    Args:
        store: the corpus.
        folder: the folder to write to.
        checks: all checks in the order in which they run.
        files: the folder that the corpus follows; empty if it follows none.
    """

    def __init__(self, store: Store, folder: Path, checks: Sequence[Check], files: str = "") -> None:
        self.store, self.folder, self.files = store, folder, files
        self._checks = list(checks)
        self.rules: dict[str, Rule] = {rule.code: rule for check in checks for rule in check.rules}
        self.survey = Survey(check.name for check in checks)
        self.settings = {
            number: {name: getattr(settings, name) for name in _SETTINGS}
            for number, settings in verdicts.all_settings(store).items()
        }
        self.players = player_rows(store)
        self._pictured = array("l")
        self._passed = array("l")

    def write(self, notes: Sequence[str] = ()) -> None:
        """Write all files.

        Args:
            notes: lines for the first page.

        Raises:
            CorpusDamaged: if the corpus is damaged.
            OSError: if a file cannot be written.
        """
        duplicates = summarise(self.store)
        chunks = Chunks(self.folder / "data", self.rules)
        with tables.Tables(self.folder) as written:
            for entry in entries(self.store):
                source = self.store.source(entry.environment.source)
                lines = source.count(b"\n") + (not source.endswith(b"\n"))
                self.survey.take(entry, lines)
                written.add(entry, lines, duplicates.cluster(entry.number))
                others = [(number, one_line(name)) for number, name in duplicates.others(entry.number)]
                chunks.add(entry, source, lines, self._command(entry), self._picture(entry), others)
        chunks.end()
        main = self.survey.settings.most_common(1)
        settings = self.settings[main[0][0]] if main else {}
        facts = {"corpus": self._title(), "made": now(), "settings": settings}
        clusters = {"layers": duplicates.layers, "clusters": [cluster for cluster, _ in duplicates.clusters]}
        tables.write_summary(self.folder, self.survey, self.rules, {**facts, **clusters, "shared": self._shared()})
        self._pages(chunks, facts, duplicates, notes)

    def _shared(self) -> list[Shared]:
        counts = {row.code: row.environments for row in self.survey.codes()}
        return shared_codes(counts, self.survey.rate.n, self._checks)

    def _title(self) -> str:
        return one_line(self.files or self.store.root.name)

    def _picture(self, entry: Entry) -> bool:
        """Copy an environment's preview, and return whether there is one."""
        file = media.preview(self.store, entry.environment)
        if file is None:
            return False
        place = self.folder / _picture(entry.number)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, place)
        (self._passed if entry.verdict == "pass" else self._pictured).append(entry.number)
        return True

    def _command(self, entry: Entry) -> str:
        """The command that judges an environment again under the same settings."""
        if entry.report is None or entry.settings is None:
            return ""
        settings = self.settings[entry.settings]
        path = f"{self.files}/{entry.name}" if self.files else str(self.store.place(entry.environment.source))
        subject = msgspec.structs.replace(entry.report, path=path)
        report = Report(settings["contract"], settings["seed"], [subject], budget=settings["budget"])
        item = Numbered(1, 1, 0, subject, CheckReport("", subject.verdict), Finding("", Severity.ERROR, ""))
        words = replay_command(report, item).splitlines()[0]
        picked = entry.environment.env_class
        return printable(f"{words} --class {picked}" if picked.isidentifier() else words)

    # Pages

    def _pages(self, chunks: Chunks, facts: dict[str, Any], duplicates: DuplicateSummary, notes: Sequence[str]) -> None:
        survey = self.survey
        counts = [(word, survey.verdicts[word]) for word in _WORDS if survey.verdicts[word]]
        common = {
            **facts,
            "survey": survey,
            "version": __version__,
            "words": _WORDS,
            "verdicts": counts,
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
            shared=self._shared(),
            duplicates=duplicates,
            clusters=[
                (cluster, len(numbers), [(number, self._shown(number)) for number in numbers[:_MEMBERS]])
                for cluster, numbers in duplicates.clusters[:_CLUSTERS]
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
        """The path of an environment's preview; empty if it has none."""
        place = _picture(number)
        return place if (self.folder / place).exists() else ""

    def _sheet(self) -> list[int]:
        """The environments with previews on the first page, spread over the corpus; passing ones if there are any."""
        numbers = self._passed or self._pictured
        count = min(_SHEET, len(numbers))
        return [numbers[place * len(numbers) // count] for place in range(count)]


class Pages:
    """The templates, with the filters and the policy that all pages share."""

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
        """Render a page. Its content security policy allows only its own scripts.

        Args:
            path: the file to write.
            template: the name of the template.
            scripts: the files whose text is the script of the page.
            values: the variables of the template.
        """
        style = _text("palette.css", Path(__file__).parents[2] / "reports") + _text("style.css")
        script = "".join(map(_text, scripts))
        policy = (
            f"default-src 'none'; img-src 'self' file: data:; style-src '{_digest(style)}'; "
            # Scripts that an allowed script loads are allowed, too.
            f"script-src '{_digest(script)}' 'strict-dynamic'; base-uri 'none'; form-action 'none'"
        )
        page = self._environment.get_template(template).render(style=style, script=script, policy=policy, **values)
        path.write_text(printable(page), "utf-8")


def build(store: Store, output: Path, checks: Sequence[Check], files: str = "", notes: Sequence[str] = ()) -> Survey:
    """Write the report on a corpus, and replace an earlier one.

    Args:
        store: the corpus.
        output: the folder of the report.
        checks: all checks in the order in which they run.
        files: the folder that the corpus follows; empty if it follows none.
        notes: lines for the first page.

    Returns:
        The numbers of the report.

    Raises:
        UsageError: if the report cannot be written.
        CorpusDamaged: if the corpus is damaged.
    """
    with replaced(output) as folder:
        site = Site(store, folder, checks, files)
        site.write(notes)
        return site.survey


def number(value: float) -> str:
    """A number with about three digits: ``0.042``, ``3.14``, ``1,250``."""
    if value >= 100 or value == int(value):
        return f"{value:,.0f}"
    return f"{value:.1f}" if value >= 10 else f"{value:.3g}"


def times(ratio: float) -> str:
    """A ratio as a factor, or as a fraction such as ``1/64`` if it is below 0.1."""
    if ratio < 0.1:
        return f"1/{1 / ratio:,.0f}"
    return f"{number(ratio) if ratio >= 1 else f'{ratio:.2f}'}\N{MULTIPLICATION SIGN}"


def interval(rate: Proportion) -> str:
    """An interval such as ``96.1 - 97.9%``, with an en dash."""
    return f"{100 * rate.low:.1f}\N{EN DASH}{100 * rate.high:.1f}%" if rate.n else ""


def _picture(place: int) -> str:
    return f"media/{place // _FOLDER}/{place}.webp"


def _text(name: str, folder: Path = TEMPLATES) -> str:
    return (folder / name).read_text("utf-8")


def _data(value: Any) -> str:
    """JSON in which an HTML parser finds no end of a script."""
    return json.dumps(plain(value)).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _digest(text: str) -> str:
    """The digest of a text as a content security policy names it."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
