"""The site: two pages with their own style and scripts, and the data that the second page loads."""

from __future__ import annotations

import shutil
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from envcraft.corpus.records import record
from envcraft.corpus.report import charts, facets, media, tables
from envcraft.corpus.report.chunks import ROWS, Chunks
from envcraft.corpus.report.data import FAR, TIMES, Entry, Survey, entries
from envcraft.corpus.report.duplicates import DuplicateSummary, summarise
from envcraft.corpus.report.embedding import Embedding
from envcraft.corpus.report.generated import generation_stages
from envcraft.corpus.report.history import history
from envcraft.corpus.report.output import replaced
from envcraft.corpus.report.page import Pages, data
from envcraft.corpus.report.players import played, player_rows
from envcraft.corpus.report.pools import PoolCoverage
from envcraft.corpus.report.results import ResultRow
from envcraft.corpus.report.words import WordIndex
from envcraft.corpus.shared import Shared, shared_codes
from envcraft.corpus.stages import in_running_order
from envcraft.corpus.store import Store, generation, now, verdicts
from envcraft.judging.check import Check, Rule
from envcraft.model.verdict import CheckReport, Finding, Report, Severity, plain
from envcraft.reports.summary import Numbered, replay_command
from envcraft.text import one_line, printable
from envcraft.version import __version__

#: The number of previews on the first page, and of rows in its lists.
_SHEET, _SLOWEST, _OUTLIERS, _CLUSTERS, _MEMBERS = 24, 10, 20, 10, 6
#: Previews in one folder.
_FOLDER = 500
#: The first three are always shown, the others if they occur.
_WORDS = {
    "pass": "passed",
    "fail": "failed",
    "undecided": "undecided",
    "error": "not judged",
    "none": "no verdict",
    "skip": "skipped",
}
_SHOWN = 3
#: The scripts of the pages, in order.
_SHARED, _ENVIRONMENTS = ("film.js",), ("site.js", "code.js", "episode.js", "environment.js", "play.js", "gallery.js")
_SETTINGS = ("contract", "budget", "seed", "driver", "rules", "image")


Episodes = Callable[[Entry, Path], list[dict[str, Any]]]


class Site:
    """One report.

    Args:
        store: the corpus.
        folder: the folder to write to.
        checks: all checks in the order in which they run.
        files: the folder that the corpus follows; empty if it follows none.
        live: whether a server with environments to play serves the pages.
        episodes: records episodes of an environment into the folder, and returns what its page needs to play them.
        results: of training.
    """

    def __init__(
        self,
        store: Store,
        folder: Path,
        checks: Sequence[Check],
        files: str = "",
        live: bool = False,
        episodes: Episodes | None = None,
        results: Sequence[ResultRow] = (),
    ) -> None:
        self.store, self.folder, self.files = store, folder, files
        self._live, self._episodes, self._results = live, episodes, results
        self._stages = in_running_order(stages) if (stages := generation.stages(store)) else []
        self._generated = generation_stages(store, self._stages)
        self._facets, self._words, self._embedding = facets.Facets(self._stages), WordIndex(), Embedding()
        self._pools = PoolCoverage(store)
        self._settings = verdicts.all_settings(store)
        self._checks = list(checks)
        self.rules: dict[str, Rule] = {rule.code: rule for check in checks for rule in check.rules}
        self.survey = Survey(check.name for check in checks)
        self.settings = {
            number: {name: getattr(settings, name) for name in _SETTINGS} for number, settings in self._settings.items()
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
                self._add(chunks, entry, source, lines, duplicates)
        chunks.end()
        main = self.survey.settings.most_common(1)
        settings = self.settings[main[0][0]] if main else {}
        facts = {"corpus": self._title(), "made": now(), "settings": settings}
        clusters = {"layers": duplicates.layers, "clusters": [cluster for cluster, _ in duplicates.clusters]}
        tables.write_summary(self.folder, self.survey, self.rules, {**facts, **clusters, "shared": self._shared()})
        self._pages(chunks, facts, duplicates, notes)

    def _add(self, chunks: Chunks, entry: Entry, source: bytes, lines: int, duplicates: DuplicateSummary) -> None:
        """Add an environment to the list, with what its page shows, and to the index of words."""
        known = history(self.store, entry.origin, self._stages)
        if known is not None:
            self._pools.add(entry, known)
        text = source.decode("utf-8", "replace")
        self._embedding.add(entry, text)
        self._words.add(
            entry.number,
            [text, *((known.title, known.text, known.brief) if known is not None else ())],
        )
        more = {
            "command": self._command(entry),
            "record": self._record(entry),
            "duplicates": duplicates.others(entry.number),
            "layers": duplicates.layers_of(entry.number),
            "history": None if known is None else known.page(),
            "players": played(self.store, entry.environment),
            "corpus": one_line(self.files or self.store.root),
            "episodes": [] if self._episodes is None else self._episodes(entry, self.folder),
        }
        row = self._facets.row(facets.values(entry, known))
        chunks.add(entry, source, lines, self._picture(entry), row, more)

    def _record(self, entry: Entry) -> str:
        """The validation record as JSON; empty if there is no verdict."""
        if entry.report is None or entry.settings is None:
            return ""
        name, source, env_class = entry.environment
        file = name if self.store.follows_folder else str(self.store.place(source).relative_to(self.store.root))
        made = record(name, file, source, env_class or None, self._settings[entry.settings], entry.report)
        return printable(msgspec.json.format(msgspec.json.encode(plain(made)), indent=1).decode())

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
        counts = [
            (word, survey.outcomes[word])
            for place, word in enumerate(_WORDS)
            if survey.outcomes[word] or (survey.judged and place < _SHOWN)
        ]
        common = {
            **facts,
            "survey": survey,
            "version": __version__,
            "words": _WORDS,
            "verdicts": counts,
            "rules": self.rules,
            "facets": self._facets.legend(),
        }
        listed = {
            "total": survey.total,
            "size": ROWS,
            "folder": _FOLDER,
            "verdicts": chunks.verdicts.words,
            "ways": [dict(way) for way in chunks.ways.words],
            "codes": [
                [code, self.rules[code].name if code in self.rules else "", code in self.rules]
                for code in chunks.codes.words
            ],
            "words": _WORDS,
            "facets": common["facets"],
            "parts": self._words.write(self.folder / "data"),
        }
        pages = Pages(self.folder, self._live)
        pages.write("environments.html", (*_SHARED, *_ENVIRONMENTS), **common, info=data(listed))
        pages.write(
            "index.html",
            _SHARED,
            **common,
            **self._figures(),
            notes=notes,
            generated=self._generated,
            players=self.players,
            results=self._results,
            others=sum(survey.settings.values()) - max(survey.settings.values(), default=0),
            sheet=[(number, survey.names[number], _picture(number)) for number in self._sheet()],
            slowest=[(number, survey.names[number], value) for number, value in survey.measures[0].highest(_SLOWEST)],
            outliers=survey.outliers(),
            shown=_OUTLIERS,
            drawn=charts.CODES,
            shared=self._shared(),
            duplicates=duplicates,
            points=self._embedding.points(),
            pools=self._pools.rows(),
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
        if self._generated:
            filters = [row.filter for row in self._generated]
            first, last = filters[0].entered, filters[-1].left
            title = f"Of {first:,} concepts, {last:,} became environments"
            drawn["generation"] = charts.cascade(filters, "generation", "begun", first, title)
        if not survey.judged:
            return {"charts": drawn}
        drawn |= {
            "cascade": charts.cascade(
                survey.stages(),
                "cascade",
                "judged",
                survey.judged,
                f"Of {survey.judged:,} environments that were judged, {survey.outcomes['pass']:,} pass",
            ),
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


def build(
    store: Store,
    output: Path,
    checks: Sequence[Check],
    files: str = "",
    notes: Sequence[str] = (),
    live: bool = False,
    episodes: Episodes | None = None,
    results: Sequence[ResultRow] = (),
) -> Survey:
    """Write the report on a corpus, and replace an earlier one.

    Args:
        store: the corpus.
        output: the folder of the report.
        checks: all checks in the order in which they run.
        files: the folder that the corpus follows; empty if it follows none.
        notes: lines for the first page.
        live: as for :class:`Site`.
        episodes: as for :class:`Site`.
        results: as for :class:`Site`.

    Returns:
        The numbers of the report.

    Raises:
        UsageError: if the report cannot be written.
        CorpusDamaged: if the corpus is damaged.
    """
    with replaced(output) as folder:
        site = Site(store, folder, checks, files, live, episodes, results)
        site.write(notes)
        return site.survey


def _picture(place: int) -> str:
    return f"media/{place // _FOLDER}/{place}.webp"
