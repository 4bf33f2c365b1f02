"""What the results of a study come to: each condition over its environments, and what two of them differ by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import fmean

import msgspec

from envcraft_dqn.study.metric import Change, Interval, Pooled, Score, by_length, by_return, paired, pooled
from envcraft_dqn.study.protocol import (
    AGENT,
    FAMILIAR,
    NOOP,
    PRETRAINED,
    PRIVILEGED,
    RANDOM,
    SEED,
    SUBSET,
    UNTRAINED,
    WITHOUT,
    Protocol,
)
from envcraft_dqn.study.work import Result


class Condition(msgspec.Struct, frozen=True):
    """How one kind of player did.

    Attributes:
        name: as :mod:`envcraft_dqn.study.protocol` has it.
        changes: one an environment and split, in the order of names.
        over: all of them; `splits` has each split by itself.
        agent: the difference to the agent in the same environments, where both were tested.
        kinds: `over` and `agent` for each kind of environment by itself, where there are several.
    """

    name: str
    changes: list[Change]
    over: Pooled
    splits: dict[int, Pooled]
    agent: Interval | None = None
    kinds: dict[str, tuple[Pooled, Interval | None]] = {}


class Summary(msgspec.Struct, frozen=True):
    """A study in numbers.

    Attributes:
        conditions: by name, the agent first.
        without_scale: environments that have no figure, since the interval of the privileged player's lead over random
            play does not lie above zero there.
        gap: by how much agents that were trained on an environment do better there than the one that was not.
        parameters: of the network.
        seconds, processor_seconds: of all tasks together.
    """

    conditions: dict[str, Condition]
    without_scale: list[str]
    gap: Interval | None
    parameters: int
    seconds: float
    processor_seconds: float


def summarise(protocol: Protocol, results: Mapping[str, Result], kinds: Mapping[str, str]) -> Summary:
    """All that the report says; `kinds` are those of the environments, by name. Every environment that was played in
    has a score of random play.
    """
    random = _scores(results.values(), RANDOM)
    privileged = _scores(results.values(), PRIVILEGED)
    changes: dict[str, list[Change]] = {}
    nowhere: set[str] = set()
    for result in results.values():
        name = result.task.condition
        if result.task.kind == "train" or name == RANDOM:
            continue
        for score in result.scores:
            change = _change(protocol, score, random, privileged, result.task.split)
            if change is None:
                nowhere.add(score.name)
            else:
                changes.setdefault(name, []).append(change)
    agent = changes.get(AGENT, [])
    conditions = {
        name: _condition(name, sorted(changes[name], key=_key), agent, kinds) for name in sorted(changes, key=_rank)
    }
    return Summary(
        conditions,
        sorted(nowhere),
        _gap(changes.get(FAMILIAR, []), agent),
        max((result.parameters for result in results.values()), default=0),
        sum(result.seconds for result in results.values()),
        sum(result.processor_seconds for result in results.values()),
    )


def _scores(results: Iterable[Result], condition: str) -> dict[str, Score]:
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
    # The environments of its training are tested in several splits, and held out in another one.
    compared = name not in (AGENT, FAMILIAR)

    def told(some: list[Change]) -> tuple[Pooled, Interval | None]:
        return pooled(some), paired(agent, some) if compared else None

    over, difference = told(changes)
    apart: dict[str, tuple[Pooled, Interval | None]] = {}
    if len(set(kinds.values())) > 1:
        by_kind = {kind: [one for one in changes if kinds[one.name] == kind] for kind in sorted(set(kinds.values()))}
        apart = {kind: told(some) for kind, some in by_kind.items() if some}
    return Condition(name, changes, over, splits, difference, apart)


def _gap(familiar: list[Change], agent: list[Change]) -> Interval | None:
    """In the environments that are in both, each of which counts once, whichever splits it was tested in."""
    by_name: dict[str, list[Change]] = {}
    for change in familiar:
        by_name.setdefault(change.name, []).append(change)
    means = [msgspec.structs.replace(some[0], value=fmean(one.value for one in some)) for some in by_name.values()]
    return paired(means, agent)


def _key(change: Change) -> tuple[str, int]:
    return change.name, change.split


def _rank(name: str) -> tuple[int, int, str]:
    """The order in which conditions are told of: subsets by their size."""
    order = (AGENT, PRETRAINED, WITHOUT, UNTRAINED, NOOP, FAMILIAR, PRIVILEGED, SEED, SUBSET)
    kind = next(number for number, known in enumerate(order) if name.startswith(known))
    number = name.rpartition(" ")[2]
    return kind, -int(number) if number.isdigit() else 0, name
