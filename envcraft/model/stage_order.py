"""The order in which the stages of generation run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar

from envcraft.errors import UsageError


class Placed(Protocol):
    """What the order of a stage depends on (:class:`envcraft.generation.stages.Stage`)."""

    name: str
    after: str
    replaces: str


_Stage = TypeVar("_Stage", bound=Placed)


def ordered(stages: Sequence[_Stage]) -> list[_Stage]:
    """Return stages in the order in which they run; stages after the same one keep their given order.

    Raises:
        UsageError: If a stage names a stage that does not exist, or stages form a cycle.
    """
    replaced = {stage.replaces: stage for stage in stages if stage.replaces}
    remaining = {stage.name: stage for stage in stages if stage.name not in replaced}
    known = {stage.name for stage in stages}
    for stage in stages:
        for name in (stage.replaces, stage.after):
            if name and name not in known:
                raise UsageError(f"the stage {stage.name} refers to the stage {name}, which does not exist")
    followers: dict[str, list[_Stage]] = {}
    for stage in remaining.values():
        # A stage that replaces another comes after the same stage as that one.
        after = stage.after or next((old.after for old in stages if old.name == stage.replaces), "")
        after = replaced[after].name if after in replaced else after
        followers.setdefault(after, []).append(stage)
    chain = list(_chain("", followers))
    if cyclic := [name for name, stage in remaining.items() if stage not in chain]:
        raise UsageError(f"the stages {', '.join(cyclic)} form a cycle")
    return chain


def _chain(name: str, followers: dict[str, list[_Stage]]) -> Iterable[_Stage]:
    # An added stage comes between a stage and its previous follower.
    for stage in sorted(followers.get(name, ()), key=lambda stage: bool(followers.get(stage.name))):
        yield stage
        yield from _chain(stage.name, followers)
