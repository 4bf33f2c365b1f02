"""The cause of a difference: why plain repetitions differ, and which earlier episodes a difference needs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from envcraft.model.rollout import Conditions, Episode, Rollout
from envcraft_checks.comparing.conditions import FAST, LOGICAL, OTHER_HASHES, OTHER_STATE, SHIFTED
from envcraft_checks.comparing.traces import diverge
from envcraft_checks.comparing.writers import Writers

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Divergence, Trace

#: Repetitions before equality counts: a number drawn from a small range may be the same by chance.
REPEATS = 7
#: Steps after the first difference that repetitions take: a single step is often the same by chance.
_BEYOND = 16
#: The code of a difference in info only, by the code of a difference elsewhere.
TELEMETRY = {"EC205": "EC210", "EC206": "EC211"}
#: Runs with a changed condition. At least one of them differs if the condition is the cause.
_CHANGES = 3
#: The most runs that reduce earlier episodes.
_TRIES = 24
#: Repetitions of the reset alone, which may draw only one random number.
_RESETS = 4


class Cause(NamedTuple):
    """Why an episode differs: the code, the conditions that show it, and the difference."""

    code: str
    conditions: Conditions
    divergence: Divergence


def code_of(subject: Subject, code: str, found: Divergence) -> str:
    """The code of a difference: a warning's if only info differs, in something else than success."""
    success = isinstance(found.first, dict) and subject.contract.success.key in found.first
    return code if found.field != "info" or success else TELEMETRY.get(code, code)


def redraw(subject: Subject, rollout: Rollout, times: int, info: bool) -> Divergence | None:
    """How one of `times` repetitions differs from the first run; None if none does."""
    first = subject.rollout(rollout, alone=True)
    repeated = (diverge(first, subject.rerun(rollout), info) for _ in range(times))
    return next((found for found in repeated if found is not None), None)


def reset_again(subject: Subject, rollout: Rollout, info: bool) -> Divergence | None:
    """How a repeated reset differs from the first; None if none does.

    Repetitions share a process, which is quick. Only if one differs, each runs in a process of its own.
    """
    first = subject.rerun(rollout, alone=False)
    repeated = (subject.rerun(rollout, alone=False) for _ in range(_RESETS))
    differs = any(diverge(first, trace, info) is not None for trace in repeated)
    return redraw(subject, rollout, REPEATS, info) if differs else None


def of_repetitions(subject: Subject, rollout: Rollout, found: Divergence, info: bool) -> Cause:
    """Name the cause of a difference between plain repetitions: the clock, the global random generators, the process,
    or the run itself.

    A cause makes all repetitions equal while it is held, and differs when it changes: few repetitions of an episode
    that rarely differs are equal by chance.
    """
    short = rollout.cut(found.step + _BEYOND)
    process = Cause("EC202", Conditions(fresh=True, heap=1), found)
    clock = Cause(code_of(subject, "EC205", found), Conditions(clock=SHIFTED), found)
    reseeded = [
        Conditions(global_seed=state, perturb=state) for state in range(OTHER_STATE, OTHER_STATE + _CHANGES + 1)
    ]

    def differ(held: Conditions, others: Iterable[Conditions]) -> bool:
        first = subject.rerun(short.under(held))
        return any(diverge(first, subject.rerun(short.under(other)), info) is not None for other in others)

    def moved(held: Conditions) -> list[Conditions]:
        return [msgspec.structs.replace(held, heap=heap) for heap in range(1, 4)]

    logical = Conditions(clock=LOGICAL)
    steady = not differ(logical, [logical] * REPEATS)
    # Addresses change only in some runs, so all repetitions may have had equal ones by chance.
    addressed = steady and differ(logical, moved(logical))
    if steady and not addressed and differ(logical, [clock.conditions] * _CHANGES):
        return clock
    # Reseeding before each call undoes what else draws from the global generators, such as a constructor that samples
    # actions until it has played a game.
    if not differ(reseeded[0], reseeded[:1] * REPEATS + moved(reseeded[0])) and differ(reseeded[0], reseeded[1:]):
        return Cause("EC204", reseeded[0], found)
    if steady:
        return process if addressed else clock
    for _ in range(REPEATS):
        twice = subject.rerun(short.under(Conditions(again=True)))
        within = diverge(twice.earlier, twice, info) if twice.earlier is not None else found
        if within is not None:
            return Cause("EC201", Conditions(again=True), within)
    return process


def by_clock(subject: Subject, rollout: Rollout, info: bool) -> Cause | None:
    """Name the clock as the cause if the episode never differs while the clock stands, and always by a fast clock.

    How much time the steps take differs from run to run, so no single run under a shifted clock shows it.
    """
    logical, fast = Conditions(clock=LOGICAL), Conditions(clock=FAST)
    first = subject.rerun(rollout.under(logical))
    if any(diverge(first, subject.rerun(rollout.under(logical)), info) is not None for _ in range(_CHANGES)):
        return None
    differing = [diverge(first, subject.rerun(rollout.under(fast)), info) for _ in range(_CHANGES)]
    found = differing[0]
    if found is None or None in differing:
        return None
    return Cause(code_of(subject, "EC205", found), fast, found)


def by_reading(subject: Subject, rollout: Rollout, info: bool) -> Cause | None:
    """Name the clock as the cause if the code reads it and moving it changes the episode, but nothing else about the
    process does while it is held.

    Any other condition may show what depends on the time of day: each run has another.
    """
    reads = Writers(subject, "EC205")
    if not reads.suspects and reads.elsewhere is None:
        return None
    held, moved = Conditions(clock=LOGICAL), Conditions(clock=SHIFTED)
    other = msgspec.structs.replace(
        held, fresh=True, hash_seed=OTHER_HASHES, global_seed=OTHER_STATE, perturb=OTHER_STATE
    )
    first = subject.rerun(rollout.under(held))
    others = (msgspec.structs.replace(other, heap=heap) for heap in range(1, _CHANGES + 1))
    if any(diverge(first, subject.rerun(rollout.under(each)), info) is not None for each in others):
        return None
    pairs = (diverge(subject.rerun(rollout), subject.rerun(rollout.under(moved)), info) for _ in range(_CHANGES))
    found = next((found for found in pairs if found is not None), None)
    return Cause(code_of(subject, "EC205", found), moved, found) if found is not None else None


def of_several(
    subject: Subject, rollout: Rollout, base: Trace, cause: Cause, parts: dict[str, str], info: bool
) -> Cause:
    """Name the cause of a difference that no condition shows alone: the clock, or the first of those that it takes.

    Args:
        subject: the environment.
        rollout: the episode, without conditions.
        base: its trace.
        cause: the difference under all conditions together.
        parts: the code of each condition, by its field.
        info: whether to compare info.
    """
    if (clock := by_clock(subject, rollout, info)) is not None:
        return clock
    default, (code, together, found) = Conditions(), cause
    left = [("fresh", "heap"), *(("perturb", "global_seed") if name == "perturb" else (name,) for name in parts)]
    taken = []
    for names in left:
        fewer = msgspec.structs.replace(together, **{name: getattr(default, name) for name in names})
        again = diverge(base, subject.rollout(rollout.under(fewer), alone=True), info) if fewer != default else None
        if again is None:
            taken.append(names[0])
        else:
            together, found = fewer, again
    return Cause(parts.get(taken[0], "EC202") if taken else code, together, found)


def fewer_episodes(
    subject: Subject, rollout: Rollout, base: Trace, conditions: Conditions, found: Divergence, info: bool
) -> tuple[Conditions, Divergence]:
    """Reduce the earlier episodes to a few that still change the trace: first by all steps, then by halves, quarters …
    of the episodes at the start or the end.
    """
    tries = _TRIES

    def shows(before: list[Episode]) -> bool:
        nonlocal conditions, found, tries
        steps = sum(len(episode.actions) for episode in before) + len(rollout.actions)
        if not before or tries <= 0 or not (subject.affords(steps) or len(before) == 1):
            return False
        tries -= 1
        fewer = Conditions(before=before)
        again = diverge(base, subject.rollout(rollout.under(fewer), alone=True), info)
        if again is not None:
            conditions, found = fewer, again
        return again is not None

    shows([Episode(episode.seed, []) for episode in conditions.before])
    part = len(conditions.before) // 2
    while part:
        before = conditions.before
        if len(before) <= part or not (shows(before[part:]) or shows(before[:-part])):
            part //= 2
    return conditions, found
