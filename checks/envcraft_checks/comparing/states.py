"""Where the states of two runs first differ: the field, the step, both values, and the line that writes it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from envcraft.model.rollout import ClockShift, Conditions, Rollout
from envcraft.text import one_line
from envcraft_checks.comparing.causes import TELEMETRY, Cause
from envcraft_checks.comparing.conditions import LOGICAL
from envcraft_checks.comparing.traces import diverge, interrupted
from envcraft_checks.comparing.writers import SHARED, Writers
from envcraft_checks.linting import program

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import StateChange, Trace

#: The share of the budget that the search for the field may take: the environment fails without it.
_SHARE = 0.2
#: Pairs of runs until one differs by chance.
_CHANCES = 3
#: The global generators, which differ because a condition sets them.
_GLOBAL = frozenset({"random", "numpy.random"})
#: Characters of a value in a message.
_SHOWN = 40
_ABSENT = "(absent)"


class FieldDifference(NamedTuple):
    """The field that differs first.

    Attributes:
        path: the field, as code reads it; ``iter(...)`` is the order of a set.
        step: after which it differs; 0 is the reset.
        first: its value in one run, as text; empty if it has none or cannot be shown.
        second: its value in the other run.
        line: the line that writes it; None if it is unknown.
        lines: those that ran in that step, in either run.
    """

    path: str
    step: int
    first: str
    second: str
    line: int | None
    lines: frozenset[int]

    @property
    def evidence(self) -> dict[str, Any]:
        """The difference for a report."""
        return {"path": self.path, "step": self.step, "first": self.first, "second": self.second, "line": self.line}

    def __str__(self) -> str:
        when = "the reset" if self.step == 0 else f"step {self.step}"
        name = f"the order of {self.path[5:-1]}" if self.path.startswith("iter(") else self.path
        known = self.first and self.second and self.first != self.second
        values = f": {self.first} and {self.second}" if known else ""
        return f"{name} differs first, after {when}{values}"


def first_field(subject: Subject, rollout: Rollout, cause: Cause, writers: Writers) -> FieldDifference | None:
    """Play a pair of runs that differ once more, and compare their states field by field.

    A third run, under the conditions of the first, shows what differs anyway, such as times: such a field is not named.

    Args:
        subject: the environment.
        rollout: the episode, without conditions.
        cause: the conditions under which it differs.
        writers: what the file says.

    Returns:
        The field that differs first; None if none does before the trace, if the runs do not differ again, or if their
        steps are too many for what the budget has left.
    """
    code, under, found = cause
    if code in TELEMETRY.values():
        return None
    short = msgspec.structs.replace(rollout.cut(found.step), fields=True)
    info, spent = found.field == "info", 0
    best: list[FieldDifference | None] = []
    for plain, changed in _pairs(under):
        cost = 2 * _steps(short, plain) + _steps(short, changed)
        if cost > subject.budget.steps * _SHARE - spent or not subject.affords(cost):
            break
        spent += cost
        if changed.again:
            twice = subject.rerun(short.under(changed))
            runs = [] if twice.earlier is None else [twice.earlier, twice]
        else:
            runs = [subject.rerun(short.under(conditions)) for conditions in (plain, changed, plain)]
        if len(runs) < 2 or any(interrupted(run) for run in runs):
            continue
        if (again := diverge(runs[0], runs[1], info)) is None:
            continue
        named = _first(writers, cause, runs, again.step)
        if len(runs) < 3 or diverge(runs[0], runs[2], info) is None:
            if named is not None:
                return named
            continue
        # Equal runs differ, too, so what they differ by may be the cause.
        best += [named, _first(writers, cause, runs[:2], again.step)]
    return next((named for named in [*best[::2], *best[1::2]] if named is not None), None)


def _pairs(under: Conditions) -> list[tuple[Conditions, Conditions]]:
    """The conditions of two runs that differ, and what to try next if these do not, or if equal ones do."""
    plain = Conditions()
    if under.clock is not None:
        # Two logical clocks differ in the same way each time, but only by the time of day.
        logical = Conditions(clock=LOGICAL)
        moved = msgspec.structs.replace(under, clock=ClockShift(under.clock.offset, 0.0))
        return [(logical, moved), (logical, under), (plain, under)]
    if under.perturb is not None and under.global_seed is not None:
        other = msgspec.structs.replace(under, global_seed=under.global_seed + 1, perturb=under.perturb + 1)
        return [(plain, under), (under, other)]
    return [(plain, under)] * (_CHANCES if under.again or under.fresh else 1)


def _steps(rollout: Rollout, under: Conditions) -> int:
    """The most steps that a run takes."""
    own = len(rollout.actions) * (1 + under.again)
    beside = min(len(under.companion.actions), own) if under.companion else 0
    return own + beside + sum(len(episode.actions) for episode in under.before)


def _first(writers: Writers, cause: Cause, runs: list[Trace], last: int) -> FieldDifference | None:
    steps = list(itertools.islice(_differing(runs[0], runs[1]), last + 1))
    compared = itertools.islice(_differing(runs[0], runs[2]), last + 1) if len(runs) > 2 else ()
    noise = {path for paths in compared for path in paths}
    given = cause.conditions.perturb is not None or cause.conditions.global_seed is not None
    ignored = noise | (_GLOBAL if given else set())
    ignored |= {path for paths in steps for path in paths if path.endswith("_space.np_random")}
    # The order of a set always differs under another hash seed, so it only counts if no value does.
    for orders in (False, True):
        for step, paths in enumerate(steps):
            named = [path for path in paths if path.startswith("iter(") == orders and path not in ignored]
            if writers.suspects and writers.code not in SHARED:
                # A line that uses a clock, an order or a draw at once leaves no other field.
                named = [path for path in named if not writers.is_idle(path)]
            if orders:
                named = writers.ordered(named)
            if named:
                lines = frozenset().union(*(run.states[step].lines for run in runs[:2]))
                path = writers.most_causal(named, cause.divergence.field)
                values = _excerpts(*(_value(run, path, step) for run in runs[:2]))
                return FieldDifference(path, step, *values, writers.line(path, lines), lines)
    return None


def in_words(writers: Writers, field: FieldDifference | None) -> tuple[str, int | None]:
    """What is known about the cause, for the end of a message, and the line that it names first.

    Args:
        writers: what the file says.
        field: the field that differs first, if it is known.
    """
    suspects, words = writers.suspects, ""
    line = None
    if writers.code in SHARED:
        # What a reset may leave as it is, such as a cache, matters only if it differs.
        written = writers.places(field.path) if field is not None else frozenset()
        suspects = [suspect for suspect in suspects if suspect.certain or suspect.line in written]
    if field is not None:
        words, line = f"; {field}", field.line
        known = writers.places(field.path), writers.around(field.path), field.lines
        ranks = {suspect: tuple(suspect.line not in lines for lines in known) for suspect in suspects}
        suspects = sorted(suspects, key=ranks.__getitem__)
        if suspects and writers.code in SHARED and field.path.startswith("self."):
            # An attribute that the reset leaves equal, or that another instance changes, follows from something else.
            line = None if writers.code == "EC207" or field.step else line
        if suspects and not (ranks[suspects[0]][0] if writers.code in SHARED else all(ranks[suspects[0]])):
            line = suspects[0].line
        elif line is not None:
            words += f", and line {line} writes it"
    if suspects:
        words += f"; {program.in_words(suspects)[0]}"
        line = line or suspects[0].line
    elif writers.elsewhere is not None:
        file, found = writers.elsewhere
        words += f"; in {one_line(file)} {program.in_words(found)[0]}"
    return words, line


def _differing(one: Trace, two: Trace) -> Iterator[list[str]]:
    """The paths that differ after each call, in the order in which the worker reads them."""
    fields: tuple[dict[str, str], dict[str, str]] = ({}, {})
    order: dict[str, int] = {}
    differing: set[str] = set()
    for changes in zip(one.states, two.states, strict=False):
        touched: set[str] = set()
        for known, change in zip(fields, changes, strict=True):
            touched |= change.changed.keys() | set(change.gone)
            known.update((path, digest) for path, (digest, _) in change.changed.items())
            for path in change.gone:
                known.pop(path, None)
            for path in change.changed:
                order.setdefault(path, len(order))
        for path in touched:
            if fields[0].get(path) == fields[1].get(path):
                differing.discard(path)
            else:
                differing.add(path)
        yield sorted(differing, key=lambda path: order.get(path, 0))


def _value(trace: Trace, path: str, step: int) -> str:
    """The text of a field after a step."""
    change: StateChange
    for change in reversed(trace.states[: step + 1]):
        if path in change.changed:
            return change.changed[path][1]
        if path in change.gone:
            break
    return _ABSENT


def _excerpts(one: str, two: str) -> tuple[str, str]:
    """Both texts, cut to what surrounds their first difference."""
    same = next((at for at, pair in enumerate(zip(one, two, strict=False)) if pair[0] != pair[1]), 0)
    start = max(same - _SHOWN // 2, 0) if max(len(one), len(two)) > _SHOWN else 0
    cut = [("..." if start else "") + text[start : start + _SHOWN] for text in (one, two)]
    ends = ["..." if len(text) > start + _SHOWN else "" for text in (one, two)]
    return cut[0] + ends[0], cut[1] + ends[1]
