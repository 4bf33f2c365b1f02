"""The figures of a report, drawn by matplotlib. Each is drawn for a wide screen and for a narrow one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from envcraft.corpus.report.data import Attempt, CheckRow, CodeRow, Measure, Stage
from envcraft.corpus.report.players import PlayerRow
from envcraft.corpus.report.svg import COLOURS, markup
from envcraft.judging.statistics import Proportion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Inches at 72 dots per inch, so that a point is a pixel.
_WIDE, _NARROW = 10.0, 5.0
_ROW = 0.36
_OUTCOMES = ("pass", "fail", "undecided", "error", "skip")
#: Maximum number of codes in the figure; the table has all.
CODES = 12
_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "envcraft",
    "font.size": 12.5,
    "text.color": COLOURS["ink"],
    "axes.labelcolor": COLOURS["soft"],
    "axes.edgecolor": COLOURS["line"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.spines.left": False,
    "xtick.color": COLOURS["line"],
    "ytick.color": COLOURS["line"],
    "xtick.labelcolor": COLOURS["soft"],
    "ytick.labelcolor": COLOURS["ink"],
    "ytick.left": False,
    "grid.color": COLOURS["line"],
}


class Drawn(NamedTuple):
    """One figure as two elements; the page shows the one that fits the screen."""

    wide: str
    narrow: str


Draw = Callable[[bool], "Figure"]


def cascade(stages: Sequence[Stage], name: str, label: str, judged: int, title: str) -> Drawn:
    """Draw how many environments or concepts are left after each stage, and how many it removed.

    Args:
        stages: in the order in which they run.
        name: of the figure.
        label: of those that enter the first stage.
        judged: their number.
        title: of the figure.
    """
    labels = [label, *(stage.name for stage in stages)]
    left = [judged, *(stage.left for stage in stages)]
    failed = [0, *(stage.failed for stage in stages)]
    unjudged = [0, *(stage.unjudged for stage in stages)]

    def draw(wide: bool) -> Figure:
        figure, axes = _rows(len(labels), wide)
        places = range(len(labels))
        axes.barh(places, left, height=0.62, color=COLOURS["pass"])
        axes.barh(places, failed, height=0.62, left=left, color=COLOURS["fail"])
        axes.barh(places, unjudged, height=0.62, left=np.add(left, failed), color=COLOURS["error"])
        for place, stage in enumerate(stages, 1):
            lost = stage.failed + stage.unjudged
            words = f"{stage.left:,}" + (f"  \N{MINUS SIGN}{lost:,}" if lost else "")
            _beside(axes, stage.entered, place, words, judged)
        _beside(axes, judged, 0, f"{judged:,}", judged)
        _names(axes, labels, judged * (1.16 if wide else 1.36))
        return figure

    return _both(draw, name, title)


def checks(rows: Sequence[CheckRow]) -> Drawn:
    """Draw the shares of each check's outcomes."""

    def draw(wide: bool) -> Figure:
        figure, axes = _rows(len(rows), wide, legend=True)
        at = np.zeros(len(rows))
        totals = np.array([max(row.outcomes.total(), 1) for row in rows])
        for outcome in _OUTCOMES:
            share = np.array([row.outcomes[outcome] for row in rows]) / totals
            axes.barh(range(len(rows)), share, height=0.62, left=at, color=COLOURS[outcome], label=outcome)
            at += share
        for place, row in enumerate(rows):
            if row.judged:
                _beside(axes, 1.0, place, f"{row.rate.estimate:.1%}", 1.0)
        _names(axes, [row.name for row in rows], 1.12 if wide else 1.24)
        box = {"handlelength": 1, "handleheight": 1, "columnspacing": 1.5 if wide else 0.9, "handletextpad": 0.5}
        axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1), ncols=len(_OUTCOMES), frameon=False, **box)
        return figure

    return _both(draw, "checks", "The shares of each check's outcomes, with the pass rate of the judged environments")


def codes(rows: Sequence[CodeRow], judged: int) -> Drawn:
    """Draw the number of environments with each of the most frequent codes.

    Args:
        rows: of the codes, by falling number of environments.
        judged: the number of environments with a verdict.
    """
    rows = rows[:CODES]

    def draw(wide: bool) -> Figure:
        figure, axes = _rows(len(rows), wide)
        colours = [COLOURS["fail" if row.severity == "error" else "skip"] for row in rows]
        axes.barh(range(len(rows)), [row.environments for row in rows], height=0.62, color=colours)
        most = max(row.environments for row in rows)
        for place, row in enumerate(rows):
            share = row.environments / max(judged, 1)
            _beside(axes, row.environments, place, f"{row.environments:,} · {share:.1%}", most)
        _names(axes, [row.code for row in rows], most * (1.16 if wide else 1.42))
        return figure

    return _both(draw, "codes", "The number of environments with each code, the most frequent first")


def distributions(measures: Sequence[Measure]) -> Drawn:
    """Draw a histogram of each measure on a logarithmic scale, with its median."""
    shown = [measure for measure in measures if measure.values]

    def draw(wide: bool) -> Figure:
        shape = (1, len(shown)) if wide else (len(shown), 1)
        figure, grid = _figure(wide, 2.1 if wide else 1.75 * len(shown), shape)
        for axes, measure in zip(np.ravel(grid), shown, strict=True):
            values = np.asarray(measure.values)
            low, high = values.min(), values.max()
            edges = np.geomspace(low / 1.05, high * 1.05, 28)
            axes.hist(values, edges, color=COLOURS["accent"])
            axes.axvline(float(np.median(values)), color=COLOURS["ink"], linewidth=1)
            axes.set_xscale("log")
            _log_ticks(axes, low / 1.05, high * 1.05)
            axes.set_yticks([])
            axes.set_title(measure.name, loc="left", fontsize=12.5, color=COLOURS["soft"])
        return figure

    return _both(draw, "spread", "The distributions of " + ", ".join(measure.name for measure in shown))


def yields(attempts: Sequence[Attempt]) -> Drawn:
    """Draw the pass rate of each attempt's environments with its interval."""

    def draw(wide: bool) -> Figure:
        figure, axes = _figure(wide, 2.4, (1, 1))
        rates = [attempt.rate for attempt in attempts]
        places = [attempt.number for attempt in attempts]
        _bars(axes, places, rates)
        axes.set_xticks(places)
        axes.set_xlabel("attempt")
        return figure

    return _both(draw, "yields", "The pass rate of each attempt")


def players(rows: Sequence[PlayerRow]) -> Drawn:
    """Draw the length of each player's episodes in steps: the median, and the 10th and 90th percentiles."""

    def draw(wide: bool) -> Figure:
        figure, axes = _rows(len(rows), wide)
        low, middle, high = np.array([row.steps for row in rows]).T
        axes.barh(range(len(rows)), high - low, height=0.3, left=low, color=COLOURS["skip"])
        axes.plot(middle, range(len(rows)), "o", color=COLOURS["accent"], markersize=8)
        for place, row in enumerate(rows):
            _beside(axes, row.steps[2], place, f"{row.steps[1]:,.0f} steps", high.max())
        _names(axes, [row.name for row in rows], high.max() * (1.16 if wide else 1.42))
        return figure

    return _both(draw, "players", "Steps of an episode by player: the median, and the 10th to the 90th percentile")


def _bars(axes: Axes, places: Sequence[int], rates: Sequence[Proportion]) -> None:
    estimates = np.array([rate.estimate for rate in rates])
    low, high = ([getattr(rate, side) for rate in rates] for side in ("low", "high"))
    reach = np.maximum([estimates - low, high - estimates], 0)
    axes.errorbar(places, estimates, reach, fmt="o", color=COLOURS["accent"], markersize=6, linewidth=1.5)
    axes.set_ylim(0, 1.02)
    axes.set_yticks([0, 0.5, 1], ["0%", "50%", "100%"])
    axes.grid(axis="y", linewidth=0.75)


def _both(draw: Draw, name: str, words: str) -> Drawn:
    with _drawing():
        return Drawn(markup(draw(True), f"{name}-w", words), markup(draw(False), f"{name}-n", words))


@contextmanager
def _drawing() -> Iterator[None]:
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield


def _figure(wide: bool, height: float, shape: tuple[int, int]) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    # Not by pyplot, which looks for a display and keeps a reference to the figure.
    figure = Figure(figsize=(_WIDE if wide else _NARROW, height), dpi=72, layout="constrained")
    return figure, figure.subplots(*shape)


def _rows(count: int, wide: bool, legend: bool = False) -> tuple[Figure, Axes]:
    """Create a figure for horizontal bars, with the first one on top."""
    figure, axes = _figure(wide, _ROW * count + 0.2 + 0.3 * legend, (1, 1))
    axes.set_ylim(count - 0.5, -0.5)
    axes.spines["bottom"].set_visible(False)
    axes.set_xticks([])
    return figure, axes


def _names(axes: Axes, labels: Sequence[str], right: float) -> None:
    axes.set_yticks(range(len(labels)), labels)
    axes.set_xlim(0, max(right, 1e-9))


def _beside(axes: Axes, end: float, place: int, words: str, whole: float) -> None:
    axes.text(end + whole * 0.012, place, words, va="center", color=COLOURS["soft"], fontsize=12)


def _log_ticks(axes: Axes, low: float, high: float) -> None:
    """Set ticks at a few round numbers."""
    from matplotlib.ticker import NullFormatter, NullLocator

    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [10.0**power for power in powers if low <= 10.0**power <= high]
    if len(ticks) < 2:
        ticks = [base * 10.0**power for power in powers for base in (1, 2, 5) if low <= base * 10.0**power <= high]
    if len(ticks) > 4:
        ticks = ticks[:: -(-len(ticks) // 4)]
    axes.set_xticks(ticks, [_short(tick) for tick in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(low, high)


def _short(value: float) -> str:
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if value >= size:
            return f"{value / size:g}{letter}"
    return f"{value:g}"
