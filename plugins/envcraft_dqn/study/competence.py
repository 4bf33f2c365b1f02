"""Competence: the agent beside its controls in several metrics, and the gate before any figure on generalisation.

An agent that does not beat every control in the environments of its own training has learned nothing that could
generalise: a policy that never looks at the frame would do as well elsewhere.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from math import hypot

import msgspec

from envcraft_dqn.study.metric import Change, Interval, Score, bootstrap
from envcraft_dqn.study.protocol import AGENT, BLIND, FAMILIAR, PRIVILEGED, RANDOM, SUBSET, UNTRAINED
from envcraft_dqn.study.worker import TaskResult

#: The metrics of a row, in the order of the report.
METRICS = ("return", "wins", "goals", "length")
_Key = tuple[str, int]


class Row(msgspec.Struct, frozen=True):
    """One condition.

    Attributes:
        condition: Its name.
        count: The number of environments, once for each split that tested them.
        means: Its metrics by name: the return on a scale from 0 (random play) to 100 (the privileged player), the share
            of episodes won, the lines or groups cleared in an episode, and the length in steps.
        leads: The paired leads of the agent in these metrics.
    """

    condition: str
    count: int
    means: dict[str, Interval]
    leads: dict[str, Interval] = {}


class Size(msgspec.Struct, frozen=True):
    """The agents that trained on one number of environments.

    Attributes:
        environments: The number of training environments.
        training, held_out: Their returns, scaled, in environments of the training and in held-out ones.
        gap: The difference. Its interval combines those of both (Zou and Donner 2008, doi:10.1002/sim.3095).
    """

    environments: int
    training: Interval
    held_out: Interval
    gap: Interval


class Competence(msgspec.Struct, frozen=True):
    """The agent and its controls.

    Attributes:
        held_out, training: Rows for the held-out environments, and for environments of the agent's training.
        sizes: The scaling curve, by the number of training environments.
        unbeaten: The controls over which the agent's lead in return in its training environments is not above zero.
    """

    held_out: list[Row]
    training: list[Row]
    sizes: list[Size]
    unbeaten: list[str]

    @property
    def passed(self) -> bool:
        """Whether the agent beats all controls in the environments of its own training."""
        return bool(self.training) and not self.unbeaten


def judge(results: Iterable[TaskResult], changes: Mapping[str, list[Change]]) -> Competence:
    """Judge the competence of the agent.

    Args:
        results: The results of all tasks.
        changes: The scaled returns by condition.
    """
    scores: dict[str, dict[_Key, Score]] = {}
    counts: dict[str, int] = {}
    for result in results:
        task = result.task
        if task.kind == "train":
            counts[task.condition] = len(task.environments)
        for score in result.scores:
            scores.setdefault(task.condition, {})[score.name, task.split] = score
    values = {
        name: _values(known, changes.get(name, []), name.removeprefix(f"{FAMILIAR} ") == RANDOM)
        for name, known in scores.items()
    }
    others = [name for name in values if name != AGENT and not name.startswith(FAMILIAR)]
    held_out = [_row(name, values[name], values.get(AGENT, {})) for name in (AGENT, *others) if name in values]
    controls = [one for one in (RANDOM, *BLIND, UNTRAINED, PRIVILEGED) if f"{FAMILIAR} {one}" in values]
    training = []
    if FAMILIAR in values:
        own = values[FAMILIAR]
        training = [_row(AGENT, own, own), *(_row(one, values[f"{FAMILIAR} {one}"], own) for one in controls)]
    unbeaten = [
        row.condition
        for row in training
        if row.condition not in (AGENT, PRIVILEGED) and not ("return" in row.leads and row.leads["return"].low > 0)
    ]
    sizes = [
        _size(counts[name], changes[known], changes[name])
        for name in counts
        if name in changes and (known := FAMILIAR if name == AGENT else f"{FAMILIAR} {name}") in changes
        if name == AGENT or name.startswith(SUBSET)
    ]
    return Competence(held_out, training, sorted(sizes, key=lambda one: one.environments), unbeaten)


def _values(scores: Mapping[_Key, Score], changes: list[Change], chance: bool) -> dict[str, dict[_Key, float]]:
    """The values of each metric by environment and split."""
    found: dict[str, dict[_Key, float]] = {name: {} for name in METRICS}
    found["return"] = {(one.name, one.split): one.value for one in changes}
    for key, score in scores.items():
        if chance:
            # The zero of the scale.
            found["return"][key] = 0.0
        found["length"][key] = score.length.mean
        for name, mean in (("wins", score.wins), ("goals", score.goals)):
            if mean is not None:
                found[name][key] = mean.mean
    return found


def _row(condition: str, values: dict[str, dict[_Key, float]], agent: dict[str, dict[_Key, float]]) -> Row:
    means = {name: _resampled(some) for name, some in values.items() if some}
    leads = {}
    if condition != AGENT:
        for name, some in values.items():
            if both := {key: agent[name][key] - value for key, value in some.items() if key in agent.get(name, {})}:
                leads[name] = _resampled(both)
    return Row(condition, len(values["length"]), means, leads)


def _resampled(values: Mapping[_Key, float]) -> Interval:
    by_agent: dict[Hashable, list[float]] = {}
    for (_, split), value in sorted(values.items()):
        by_agent.setdefault(split, []).append(value)
    return bootstrap(by_agent)


def _size(environments: int, training: list[Change], held_out: list[Change]) -> Size:
    ours, theirs = (_resampled({(one.name, one.split): one.value for one in some}) for some in (training, held_out))
    mean = ours.mean - theirs.mean
    low = mean - hypot(ours.mean - ours.low, theirs.high - theirs.mean)
    high = mean + hypot(ours.high - ours.mean, theirs.mean - theirs.low)
    return Size(environments, ours, theirs, Interval(mean, low, high))
