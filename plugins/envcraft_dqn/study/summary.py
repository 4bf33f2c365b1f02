"""Summarise the results of a study: each condition, and its difference from the agent."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import fmean

import msgspec

from envcraft_dqn.study.competence import Competence, judge
from envcraft_dqn.study.metric import Change, Interval, Pooled, Score, by_length, by_return, paired, pooled
from envcraft_dqn.study.protocol import (
    AGENT,
    COIN,
    CONSTANT,
    FAMILIAR,
    NOOP,
    PRETRAINED,
    PRIVILEGED,
    RANDOM,
    SEED,
    SHUFFLED,
    SUBSET,
    UNTRAINED,
    WITHOUT,
    Protocol,
)
from envcraft_dqn.study.worker import TaskResult


class Condition(msgspec.Struct, frozen=True):
    """The results of one condition.

    Attributes:
        name: The name in :mod:`envcraft_dqn.study.protocol`.
        changes: The metric by environment and split, sorted by name.
        over: Statistics over all environments.
        splits: Statistics of each split.
        agent: The mean paired lead of the agent in the environments of both.
        kinds: `over` and `agent` for each kind of environments, if there are several kinds.
    """

    name: str
    changes: list[Change]
    over: Pooled
    splits: dict[int, Pooled]
    agent: Interval | None = None
    kinds: dict[str, tuple[Pooled, Interval | None]] = {}


class Summary(msgspec.Struct, frozen=True):
    """The results of a study.

    Attributes:
        protocol: The protocol.
        conditions: The conditions by name, the agent first.
        without_scale: Environments without a metric, because the confidence interval of the privileged player's lead
            over random play is not above zero.
        competence: The agent beside its controls, and the scaling curve.
        gap: The generalisation gap: the lead of agents trained on an environment over the agent that was not.
        parameters: The number of parameters of the network.
        updates, steps: The updates and online steps of an agent; whole turns may exceed those of the settings.
        precisions: The precisions of the trainings.
        seconds, processor_seconds: The total time of all tasks.
    """

    protocol: Protocol
    conditions: dict[str, Condition]
    without_scale: list[str]
    competence: Competence
    gap: Interval | None
    parameters: int
    updates: int
    steps: int
    precisions: list[str]
    seconds: float
    processor_seconds: float


def summarise(protocol: Protocol, results: Mapping[str, TaskResult], kinds: Mapping[str, str]) -> Summary:
    """Summarise the results of a study.

    Args:
        protocol: The protocol.
        results: The results of the tasks by name, with a score of random play for every environment.
        kinds: The kinds of the environments by name.
    """
    random, privileged = (
        _scores(results.values(), f"{FAMILIAR} {player}") | _scores(results.values(), player)
        for player in (RANDOM, PRIVILEGED)
    )
    changes: dict[str, list[Change]] = {}
    without_scale: set[str] = set()
    for result in results.values():
        name = result.task.condition
        if result.task.kind == "train" or name.removeprefix(f"{FAMILIAR} ") == RANDOM:
            continue
        for score in result.scores:
            change = _change(protocol, score, random, privileged, result.task.split)
            if change is None:
                without_scale.add(score.name)
            else:
                changes.setdefault(name, []).append(change)
    agent = changes.get(AGENT, [])
    shown = [name for name in changes if name == FAMILIAR or not name.startswith(FAMILIAR)]
    conditions = {
        name: _condition(name, sorted(changes[name], key=_key), agent, kinds) for name in sorted(shown, key=_rank)
    }
    agents = [result for result in results.values() if result.task.condition == AGENT]
    return Summary(
        protocol,
        conditions,
        sorted(without_scale),
        judge(results.values(), changes),
        _gap(changes.get(FAMILIAR, []), agent),
        max((one.parameters for one in agents), default=0),
        max((one.updates for one in agents), default=0),
        max((one.steps for one in agents), default=0),
        sorted({result.precision for result in results.values()} - {""}),
        sum(result.seconds for result in results.values()),
        sum(result.processor_seconds for result in results.values()),
    )


def _scores(results: Iterable[TaskResult], condition: str) -> dict[str, Score]:
    return {score.name: score for result in results if result.task.condition == condition for score in result.scores}


def _change(
    protocol: Protocol, score: Score, random: Mapping[str, Score], privileged: Mapping[str, Score], split: int
) -> Change | None:
    if protocol.metric == "length":
        return by_length(score, random[score.name], split)
    return by_return(score, random[score.name], privileged[score.name], split)


def _condition(name: str, changes: list[Change], agent: list[Change], kinds: Mapping[str, str]) -> Condition:
    numbers = sorted({change.split for change in changes})
    splits = {number: pooled([one for one in changes if one.split == number]) for number in numbers}
    # Familiar environments are tested in several splits, so that they have no paired test environment.
    compared = name not in (AGENT, FAMILIAR)

    def statistics(some: list[Change]) -> tuple[Pooled, Interval | None]:
        return pooled(some), paired(agent, some) if compared else None

    over, difference = statistics(changes)
    apart: dict[str, tuple[Pooled, Interval | None]] = {}
    if len(set(kinds.values())) > 1:
        by_kind = {kind: [one for one in changes if kinds[one.name] == kind] for kind in sorted(set(kinds.values()))}
        apart = {kind: statistics(some) for kind, some in by_kind.items() if some}
    return Condition(name, changes, over, splits, difference, apart)


def _gap(familiar: list[Change], agent: list[Change]) -> Interval | None:
    """The gap over the environments in both lists. Each counts once, even if several splits tested it."""
    by_name: dict[str, list[Change]] = {}
    for change in familiar:
        by_name.setdefault(change.name, []).append(change)
    means = [msgspec.structs.replace(some[0], value=fmean(one.value for one in some)) for some in by_name.values()]
    return paired(means, agent)


def _key(change: Change) -> tuple[str, int]:
    return change.name, change.split


def _rank(name: str) -> tuple[int, int, str]:
    """The rank of a condition in reports. Subsets are ranked by size."""
    order = (AGENT, PRETRAINED, WITHOUT, UNTRAINED, NOOP, COIN, CONSTANT, SHUFFLED, FAMILIAR, PRIVILEGED, SEED, SUBSET)
    kind = next(number for number, known in enumerate(order) if name.startswith(known))
    number = name.rpartition(" ")[2]
    return kind, -int(number) if number.isdigit() else 0, name
