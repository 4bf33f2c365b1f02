"""The figures of a study as PNG files, drawn by matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from envcraft_dqn.study.competence import Size
from envcraft_dqn.study.metric import Interval
from envcraft_dqn.study.protocol import AGENT, SUBSET, Protocol
from envcraft_dqn.study.summary import Condition, Summary
from envcraft_dqn.study.worker import TaskResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INK, _SOFT, _UP, _DOWN, _MEAN = "#1f2430", "#6b7280", "#4c78a8", "#c2674a", "#1b7f5c"
_STYLE: Any = {
    "font.size": 10,
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": _SOFT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": _SOFT,
    "ytick.color": _SOFT,
}
_WIDTH = 9.0


def unit(protocol: Protocol) -> str:
    """The name of the metric with its unit."""
    if protocol.metric == "length":
        return "change of mean episode length over random play, %"
    return "return, 0 random, 100 privileged player"


def draw(
    folder: Path, protocol: Protocol, results: Mapping[str, TaskResult], summary: Summary
) -> list[tuple[str, str]]:
    """Draw the figures that have data into a folder; return their names and captions. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for name, condition in summary.conditions.items():
        if name in (AGENT, "pretrained"):
            _save(folder / f"{name}.png", 3.6, lambda axes, found=condition: _bars(axes, found, protocol))
            held_out = f"{condition.over.count} held-out environments"
            when = "after pretraining alone" if name != AGENT else "after all of its training"
            drawn.append(
                (
                    name,
                    f"The agent {when} in {held_out}, and the mean, with 95% confidence intervals.",
                )
            )
    _save(folder / "conditions.png", 0.9 + 0.36 * len(summary.conditions), lambda axes: _dots(axes, protocol, summary))
    drawn.append(("conditions", "The agent and its controls: means over environments with 95% confidence intervals."))
    sizes = _sizes(results, summary)
    if len(sizes) > 1:
        _save(folder / "scaling.png", 3.4, lambda axes: _scaling(axes, protocol, sizes, summary.competence.sizes))
        drawn.append(("scaling", "The metric by the number of training environments."))
    curves = [result for result in results.values() if result.curve and result.task.condition == AGENT]
    _save(folder / "curves.png", 4.8, lambda top, bottom: _curves(top, bottom, curves), 2)
    drawn.append(
        (
            "curves",
            "Learning curves by split: the loss, and the length of training episodes, random actions included. The "
            "lengths leave out episodes that a forced reset truncated.",
        )
    )
    return drawn


def _save(file: Path, height: float, paint: Callable[..., None], panels: int = 1) -> None:
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        from matplotlib.figure import Figure

        # Without pyplot, which would need a display backend and keep the figure.
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        paint(*figure.subplots(panels, 1, squeeze=False)[:, 0])
        # Without the version of matplotlib, equal numbers give equal files.
        figure.savefig(file, dpi=110, metadata={"Software": None})


def _bars(axes: Axes, condition: Condition, protocol: Protocol) -> None:
    """Draw sorted bars with intervals, and the mean as a line with its interval as a band."""
    changes = sorted(condition.changes, key=lambda change: change.value)
    values = np.array([change.value for change in changes])
    places = np.arange(len(values))
    axes.bar(places, values, color=[_UP if value > 0 else _DOWN for value in values], width=0.85)
    errors = [values - [change.low for change in changes], [change.high for change in changes] - values]
    axes.errorbar(places, values, yerr=np.array(errors), fmt="none", ecolor=_INK, elinewidth=0.6, alpha=0.6)
    mean = condition.over.value
    if np.isfinite(mean.low):
        axes.axhspan(mean.low, mean.high, color=_MEAN, alpha=0.2, linewidth=0)
    axes.axhline(mean.mean, color=_MEAN, label=f"mean {mean.mean:+.1f} [{mean.low:.1f}, {mean.high:.1f}]")
    axes.axhline(0, color=_SOFT, linewidth=0.8)
    axes.set_xticks([])
    axes.set_xlim(-1, len(values))
    axes.set_xlabel("environments, sorted")
    axes.set_ylabel(_wrapped(unit(protocol)))
    axes.legend(loc="upper left", frameon=False)


def _dots(axes: Axes, protocol: Protocol, summary: Summary) -> None:
    found = list(summary.conditions.values())
    axes.set_yticks(range(len(found)), [condition.name for condition in found])
    axes.set_ylim(len(found) - 0.5, -0.5)
    for place, condition in enumerate(found):
        mean = condition.over.value
        axes.errorbar([mean.mean], [place], xerr=_errors([mean]), fmt="o", color=_MEAN, capsize=3)
    # A linear scale would squeeze all other values if there is an outlier.
    if max(abs(condition.over.value.mean) for condition in found) > 100:
        axes.set_xscale("symlog", linthresh=10)
    axes.axvline(0, color=_SOFT, linewidth=0.8)
    axes.set_xlabel(unit(protocol))


def _sizes(results: Mapping[str, TaskResult], summary: Summary) -> list[tuple[int, Condition]]:
    """The number of training environments and the results, sorted by that number."""
    count = {task.condition: len(task.environments) for task in (result.task for result in results.values())
             if task.kind == "train"}  # fmt: skip
    scaled = (AGENT, SUBSET)
    return sorted(
        ((count[name], found) for name, found in summary.conditions.items() if name.startswith(scaled)),
        key=lambda pair: pair[0],
    )


def _scaling(axes: Axes, protocol: Protocol, sizes: Sequence[tuple[int, Condition]], both: Sequence[Size]) -> None:
    means = [condition.over.value for _, condition in sizes]
    places = [size for size, _ in sizes]
    held_out: Any = {"fmt": "o-", "color": _MEAN, "capsize": 3, "label": "held out"}
    axes.errorbar(places, [mean.mean for mean in means], yerr=_errors(means), **held_out)
    if len(both) > 1:
        known, own = [one.environments for one in both], [one.training for one in both]
        training: Any = {"fmt": "s--", "color": _UP, "capsize": 3, "label": "environments of the training"}
        axes.errorbar(known, [mean.mean for mean in own], yerr=_errors(own), **training)
        axes.legend(frameon=False)
        axes.set_xscale("log")
    axes.axhline(0, color=_SOFT, linewidth=0.8)
    axes.set_xlabel("training environments")
    axes.set_ylabel(_wrapped(unit(protocol)))


def _errors(means: Sequence[Interval]) -> NDArray[np.float64]:
    """The widths of intervals on either side of the mean; 0 for infinite intervals."""
    reach = np.array([[mean.mean - mean.low for mean in means], [mean.high - mean.mean for mean in means]])
    return np.where(np.isfinite(reach), reach, 0.0)


def _curves(top: Axes, bottom: Axes, found: Sequence[TaskResult]) -> None:
    for result in found:
        for axes, name in ((top, "loss"), (bottom, "length")):
            points = [(point["updates"], point[name]) for point in result.curve if point[name] is not None]
            if points:
                axes.plot(*zip(*points, strict=True), linewidth=1, label=f"split {result.task.split + 1}")
    last = [point["updates"] for result in found for point in result.curve if point["phase"] == "pretraining"]
    if last:
        for axes in (top, bottom):
            axes.axvline(max(last), color=_SOFT, linewidth=0.8, linestyle=":")
        top.annotate("online", (max(last), 1), xycoords=("data", "axes fraction"), xytext=(4, -10),
                     textcoords="offset points", color=_SOFT)  # fmt: skip
    top.set_ylabel("loss")
    bottom.set_ylabel("episode length, steps")
    bottom.set_xlabel("updates")
    bottom.sharex(top)
    if found:
        top.legend(frameon=False, ncols=5, fontsize=8)


def _wrapped(words: str) -> str:
    return words.replace(" over ", "\nover ").replace(", 100", "\n100")
