"""The conditions under which an episode must give the same trace, each with the code of its finding."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from envcraft.model.rollout import ClockShift, Conditions, Episode, Rollout

from .traces import interrupted

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.spaces.spec import SpaceSpec

SHIFTED = ClockShift(offset=12_345_678.912_3, rate=7.3)
LOGICAL = ClockShift(offset=0.0, rate=0.0)
#: A clock by which a few steps take minutes.
FAST = ClockShift(offset=SHIFTED.offset, rate=100_000.0)
OTHER_HASHES = 20_241
OTHER_STATE = 1_000_003
#: The conditions of how actions are passed.
HABITS = {"reuse", "int32", "python"}
#: The phases that are calls of a condition, and its name.
_OWN_CALLS = {"earlier reset": "before", "before": "before", "companion": "companion"}


def together(subject: Subject, rollout: Rollout, left_out: frozenset[str] = frozenset()) -> Conditions:
    """All conditions at the same time, without those `left_out`."""
    return msgspec.structs.replace(
        Conditions(fresh=True, heap=1, hash_seed=OTHER_HASHES),
        **{
            name: getattr(conditions, name)
            for _, conditions, name in alone(subject, rollout)
            if name != "hash_seed" and name not in left_out
        },
    )


def alone(subject: Subject, rollout: Rollout) -> list[tuple[str, Conditions, str]]:
    """Each condition alone: the code of its finding, the condition, and its field."""
    from envcraft.judging import actions

    seed = rollout.seed + 8_009
    beside = Episode(seed, actions.random_actions(subject.action_space, seed, subject.budget.beside))
    before = subject.probes.earlier(rollout, subject.searches.best(), subject.episodes.idle)
    rendered = [("EC208", Conditions(render=True), "render")] if _renders(subject) else []
    taken = "options" in subject.load().description.get("reset", ("options",))
    optional = [("EC214", Conditions(options=True), "options")] if taken else []
    return [
        ("EC203", Conditions(hash_seed=OTHER_HASHES), "hash_seed"),
        ("EC204", Conditions(global_seed=OTHER_STATE, perturb=OTHER_STATE), "perturb"),
        ("EC205", Conditions(clock=SHIFTED), "clock"),
        ("EC206", Conditions(before=before), "before"),
        ("EC207", Conditions(companion=beside), "companion"),
        *rendered,
        *optional,
        *_habits(subject.action_space),
    ]


def interrupting(subject: Subject, rollout: Rollout, left_out: frozenset[str]) -> frozenset[str]:
    """The conditions whose own calls raise, with the others and alone: earlier episodes, say, of a game that crashes.

    They end the episode before it can be compared, so the other conditions are judged without them.
    """
    by_name = {name: conditions for _, conditions, name in alone(subject, rollout) if name not in left_out}
    found: set[str] = set()
    while True:
        trace = subject.rollout(rollout.under(together(subject, rollout, left_out | found)), alone=True)
        name = _OWN_CALLS.get(trace.fault.phase, "") if trace.fault is not None else ""
        if name not in by_name or name in found:
            return frozenset(found)
        if not interrupted(subject.rollout(rollout.under(by_name[name]), alone=True)):
            return frozenset(found)
        found.add(name)


def _renders(subject: Subject) -> bool:
    """Whether render() can be called: one that raises would end every episode of all conditions together."""
    if not subject.renders:
        return False
    fault = subject.rendered().fault
    return fault is None or fault.phase != "render"


def _habits(space: SpaceSpec) -> list[tuple[str, Conditions, str]]:
    """The conditions of how actions are passed, as far as they change anything in a space."""
    from envcraft.spaces.spec import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Tuple

    spaces, kinds = [space], set()
    for inner in spaces:
        kinds.add(type(inner))
        if isinstance(inner, Dict):
            spaces += [item for _, item in inner.spaces]
        elif isinstance(inner, Tuple):
            spaces += inner.spaces
    habits = []
    if kinds & {Box, MultiDiscrete, MultiBinary}:
        habits.append(("EC215", Conditions(reuse=True), "reuse"))
    if kinds & {Discrete, MultiDiscrete, MultiBinary}:
        habits.append(("EC216", Conditions(int32=True), "int32"))
        # Agents that step a single Discrete space often pass an int.
        habits.append(("EC216" if kinds == {Discrete} else "EC218", Conditions(python=True), "python"))
    return habits
