"""The figures of a study, drawn by matplotlib: ``NAME.png`` in a folder each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from envcraft_dqn.study.metric import Interval
from envcraft_dqn.study.protocol import AGENT, SUBSET, Protocol
from envcraft_dqn.study.summary import Condition, Summary
from envcraft_dqn.study.work import Result

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
    """What the figures of environments are called."""
    if protocol.metric == "length":
        return "change of mean episode length over random play, %"
    return "return, 0 random, 100 privileged player"


def draw(folder: Path, protocol: Protocol, results: Mapping[str, Result], summary: Summary) -> list[tuple[str, str]]:
    """Draw all that there is something for; give the name and the words below each. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for name, condition in summary.conditions.items():
        if name in (AGENT, "pretrained"):
            _save(folder / f"{name}.png", 3.6, lambda axes, found=condition: _bars(axes, found, protocol))
            held = f"{condition.over.count} environments that were held out"
            words = "after pretraining alone" if name != AGENT else "after all of its training"
            drawn.append(
                (name, f"The agent {words}, in {held}: each with its 95% interval, the mean and its interval.")
            )
    _save(folder / "conditions.png", 0.9 + 0.36 * len(summary.conditions), lambda axes: _dots(axes, protocol, summary))
    drawn.append(("conditions", "The agent and its controls: means over environments with 95% intervals."))
    sizes = _sizes(results, summary)
    if len(sizes) > 1:
        _save(folder / "scaling.png", 3.4, lambda axes: _scaling(axes, protocol, sizes))
        drawn.append(("scaling", "By how many environments an agent was trained on."))
    curves = [result for result in results.values() if result.curve and result.task.condition == AGENT]
    _save(folder / "curves.png", 4.8, lambda top, bottom: _curves(top, bottom, curves), 2)
    drawn.append(
        (
            "curves",
            "Learning, a line a split: the loss, and the length of episodes in the environments of the training, of "
            "those that ended before their turn did, random actions included.",
        )
    )
    return drawn


def _save(file: Path, height: float, paint: Callable[..., None], panels: int = 1) -> None:
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        from matplotlib.figure import Figure

        # By itself, not by pyplot, which would look for a screen and keep it.
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        paint(*figure.subplots(panels, 1, squeeze=False)[:, 0])
        # The same picture from the same numbers, whichever version drew it.
        figure.savefig(file, dpi=110, metadata={"Software": None})


def _bars(axes: Axes, condition: Condition, protocol: Protocol) -> None:
    """Sorted bars with intervals, the mean as a line and its interval as a band."""
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
    # One that is far off leaves no room for the others.
    if max(abs(condition.over.value.mean) for condition in found) > 100:
        axes.set_xscale("symlog", linthresh=10)
    axes.axvline(0, color=_SOFT, linewidth=0.8)
    axes.set_xlabel(unit(protocol))


def _sizes(results: Mapping[str, Result], summary: Summary) -> list[tuple[int, Condition]]:
    """How many environments were trained on, and what that led to, the fewest first."""
    count = {task.condition: len(task.environments) for task in (result.task for result in results.values())
             if task.kind == "train"}  # fmt: skip
    wanted = (AGENT, SUBSET)
    return sorted(
        ((count[name], found) for name, found in summary.conditions.items() if name.startswith(wanted)),
        key=lambda pair: pair[0],
    )


def _scaling(axes: Axes, protocol: Protocol, sizes: Sequence[tuple[int, Condition]]) -> None:
    means = [condition.over.value for _, condition in sizes]
    places = [size for size, _ in sizes]
    axes.errorbar(places, [mean.mean for mean in means], yerr=_errors(means), fmt="o-", color=_MEAN, capsize=3)
    axes.axhline(0, color=_SOFT, linewidth=0.8)
    axes.set_xlabel("environments of the training")
    axes.set_ylabel(_wrapped(unit(protocol)))


def _errors(means: Sequence[Interval]) -> NDArray[np.float64]:
    """How far intervals reach to either side; 0 for that of a single environment, which has no bounds."""
    reach = np.array([[mean.mean - mean.low for mean in means], [mean.high - mean.mean for mean in means]])
    return np.where(np.isfinite(reach), reach, 0.0)


def _curves(top: Axes, bottom: Axes, found: Sequence[Result]) -> None:
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
