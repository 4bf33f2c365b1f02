"""# determinism

## What it does
Plays the same seed and actions again and compares whole traces bit by bit: frames, rewards, flags and info. The first
repetition runs in another process. The second changes all conditions at the same time: a new worker with another
PYTHONHASHSEED, global random generators in another state, a shifted and faster clock, empty options, earlier episodes
on the same instance, a second instance that is stepped alongside, `render()` between the steps, and actions as other
callers pass them: in one array that they overwrite for each step, as int32, and as Python's ints and lists where the
action space contains these. If this trace differs, the check tries each condition alone. The finding names the
condition, the first step and the field.

The episodes are random play and the best episode of a search, such as a win. The earlier episodes include the same
episode, the best one, a win several times, and one that does nothing until the end. Last, the first steps of random
play are compared after many short episodes on the same instance, which other checks also judge.

Different seeds must give different traces. One fixed level for every seed is a legitimate design and only a warning.
Training passes a seed to the first reset only: the episodes that follow it must be the same when the program runs
again, and must not all be one level if seeds give several, since an agent would train on that level alone.

An info value that depends on nothing but the clock, or counts the episodes, is telemetry and only a warning. The check
then compares again without info, so that telemetry hides no other difference.

## Why is this bad?
An experiment that cannot be repeated cannot be debugged, compared or replayed from a seed. Such an environment also
behaves differently if an agent shares its process with other environments or draws random numbers of its own.

## Example
```python
def reset(self, *, seed=None, options=None):
    super().reset(seed=seed)
    self.food = random.randrange(64)   # EC204: use self.np_random.integers(64)
```
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import Skip
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.rollout import ClockShift, Conditions, Episode, Rollout
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl
from envcraft.text import plural

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Divergence, Trace
    from envcraft.spaces.spec import SpaceSpec

_SHIFTED = ClockShift(offset=12_345_678.912_3, rate=7.3)
_LOGICAL = ClockShift(offset=0.0, rate=0.0)
#: The code of a difference in info only, by the code of a difference elsewhere.
_TELEMETRY = {"EC205": "EC210", "EC206": "EC211"}
#: Codes after which the comparison goes on without their cause.
_WARNINGS = {*_TELEMETRY.values(), "EC218"}
#: The conditions of how actions are passed.
_HABITS = {"reuse", "int32", "python"}
_OTHER_HASHES = 20_241
_OTHER_STATE = 1_000_003
#: Repetitions before equality counts: a number drawn from a small range may be the same by chance.
_REPEATS = 7
#: Repetitions of a condition, one of which must differ again.
_CONFIRMED = 3
#: The most runs that reduce earlier episodes.
_TRIES = 24
#: Repetitions of the reset alone, which may draw only one random number.
_RESETS = 4
#: For resets without a seed: steps of an episode, repetitions of the first, and episodes that must be equal for EC212.
_UNSEEDED_STEPS, _UNSEEDED_AGAIN, _UNSEEDED = 10, 2, 8
#: Steps after which seeds are compared first.
_SEEDED_STEPS = 20


class Determinism(Check):
    name = "determinism"
    hash_seeds = (_OTHER_HASHES,)
    rules = (
        Rule(
            "EC201",
            "run-again",
            "The same seed gives another trace when it is run again.",
            "Draw from self.np_random only.",
        ),
        Rule(
            "EC202",
            "fresh-process",
            "The trace depends on the process.",
            "Do not depend on id(), the process id, or the order of a set of objects.",
        ),
        Rule(
            "EC203",
            "hash-seed",
            "The trace depends on PYTHONHASHSEED.",
            "Sort sets of strings before iterating over them.",
        ),
        Rule(
            "EC204",
            "global-random",
            "The trace depends on the global random or numpy.random state.",
            "Draw from self.np_random, seeded by super().reset(seed=seed).",
        ),
        Rule("EC205", "clock", "The trace depends on the clock.", "Count steps instead of reading the time."),
        Rule(
            "EC206",
            "earlier-episodes",
            "The trace depends on earlier episodes.",
            "Let reset() set every attribute that step() changes.",
        ),
        Rule(
            "EC207",
            "second-instance",
            "The trace depends on another instance.",
            "Keep state in self, not in the class or the module.",
        ),
        Rule(
            "EC208",
            "render-between",
            "The trace depends on calls of render().",
            "Only draw in render(); do not change the state.",
        ),
        Rule(
            "EC209",
            "seed-ignored",
            "Different seeds give the same trace.",
            "Fine for one fixed level; otherwise draw the level from self.np_random.",
            Severity.WARNING,
        ),
        Rule(
            "EC210",
            "clock-in-info",
            "info depends on the clock.",
            "Fine for telemetry, as long as agents do not read it.",
            Severity.WARNING,
        ),
        Rule(
            "EC211",
            "episodes-in-info",
            "info depends on earlier episodes.",
            "Fine for a count of episodes, as long as agents do not read it.",
            Severity.WARNING,
        ),
        Rule(
            "EC212",
            "unseeded-alike",
            "Every reset without a seed gives the same episode, although seeds give different ones.",
            "Do not choose a seed if reset() receives none: call super().reset(seed=seed) and use self.np_random.",
        ),
        Rule(
            "EC213",
            "unseeded-differs",
            "Unseeded episodes after a seeded one differ when they are run again.",
            "Keep the generator if reset() receives no seed: call super().reset(seed=seed) and use self.np_random.",
            Severity.WARNING,
        ),
        Rule(
            "EC214",
            "empty-options",
            "The trace depends on whether reset() receives empty options or None.",
            "Treat options={} as options=None: `options = options or {}`.",
        ),
        Rule(
            "EC215",
            "action-kept",
            "The trace depends on whether the caller reuses its action array.",
            "Keep a copy of the action: `self.last = np.array(action)`.",
        ),
        Rule(
            "EC216",
            "action-type",
            "The trace depends on the integer type of the action.",
            "Convert first: `action = int(action)`, or `np.asarray(action, np.int64)`.",
        ),
        Rule(
            "EC218",
            "action-list",
            "step() cannot take a list that its action space contains.",
            "Convert first: `action = np.asarray(action)`.",
            Severity.WARNING,
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if subject.load().description.get("nondeterministic"):
            raise Skip("the environment is registered as nondeterministic")
        length = subject.budget.probes[1]
        plays = subject.episodes.probed
        reset = list(itertools.takewhile(lambda play: play.observations, plays))
        probes = [play.rollout.cut(min(length, max(play.steps, 1))) for play in reset]
        for rollout in probes:
            subject.prefetch([rollout, rollout.under(self._together(subject, rollout))], alone=True)
            subject.prefetch([rollout], again=True)
        reported: set[str] = set()
        if len(reset) == len(plays) and (found := subject.searches.best()) is not None:
            probes.append(found.rollout.cut(found.steps))
        for number, rollout in enumerate(probes):
            left_out = frozenset({"python"} if "EC218" in reported else ())
            if number >= len(plays) and not self._differs(subject, rollout, left_out):
                continue
            for finding in self._probe(subject, rollout, left_out):
                if finding.code not in reported:
                    reported.add(finding.code)
                    yield finding
            if reported - _WARNINGS:
                # Each further seed would try all conditions again for the same defect.
                return
        if len(reset) < len(plays):
            raise Skip("reset() returns no observation")
        for finding in self._after_many(subject):
            if finding.code not in reported:
                yield finding
            if finding.code == "EC206":
                return
        fixed = list(self._judge_seeds(subject))
        yield from fixed
        yield from self._judge_unseeded(subject, bool(fixed))

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code == "EC209":
            return next(self._judge_seeds(subject), None)
        if finding.code in ("EC212", "EC213"):
            findings = self._judge_unseeded(subject, fixed=False)
            return next((again for again in findings if again.code == finding.code), None)
        conditions = Conditions.from_json(finding.repro.conditions)
        rollout = Rollout(finding.repro.seed, finding.repro.actions)
        info = finding.evidence.get("field") == "info"
        for _ in range(_REPEATS):
            if conditions.again:
                trace = subject.rerun(rollout.under(conditions))
                found = _diverge(trace.earlier, trace, info) if trace.earlier else None
            else:
                found = _diverge(subject.rerun(rollout), subject.rerun(rollout.under(conditions)), info)
            if found is not None:
                return self._found(subject, finding.code, rollout, conditions, found)
        return None

    def _differs(self, subject: Subject, rollout: Rollout, left_out: frozenset[str]) -> bool:
        """Whether an episode differs when all conditions change at the same time."""
        everything = subject.rollout(rollout.under(self._together(subject, rollout, left_out)), alone=True)
        return _interrupted(everything) or _diverge(subject.rollout(rollout), everything, info=True) is not None

    def _probe(self, subject: Subject, rollout: Rollout, left_out: frozenset[str]) -> Iterator[Finding]:
        """Compare traces with info. Compare them again without what is only a warning, which may hide other
        differences: lists, and then info.
        """
        info = True
        while True:
            codes = set()
            for finding in self._compare(subject, rollout, info, left_out):
                codes.add(finding.code)
                yield finding
            if not codes or codes - _WARNINGS:
                return
            if "EC218" in codes and "python" not in left_out:
                left_out |= {"python"}
            elif info:
                info = False
            else:
                return

    def _compare(
        self, subject: Subject, rollout: Rollout, info: bool, left_out: frozenset[str] = frozenset()
    ) -> Iterator[Finding]:
        """Compare an episode with its repetition, and with the one under all conditions but those `left_out`."""
        base, repeated = subject.rollout(rollout, alone=True), subject.rerun(rollout)
        found = _diverge(base, repeated, info) or self._reset_again(subject, rollout.cut(0), info)
        if found is not None:
            yield self._attribute_repeat(subject, rollout, found, info)
            return
        together = self._together(subject, rollout, left_out)
        everything = subject.rollout(rollout.under(together), alone=True)
        found = _diverge(base, everything, info)
        if found is None and not _interrupted(everything):
            return
        alone = [each for each in self._alone(subject, rollout) if each[2] not in left_out]
        if found is not None and everything.fault is not None:
            # What raises at an unusual action does so at once, and needs no search for another cause.
            raised = list(self._raised(subject, rollout.cut(found.step), alone, info))
            yield from raised
            if raised:
                return
        if found is not None:
            again = self._redraw(subject, rollout.cut(found.step), _REPEATS, info)
            if again is not None:
                yield self._attribute_repeat(subject, rollout, again, info)
                return
        reported = False
        if found is not None:
            # Whichever condition causes it, the difference shows in these steps.
            rollout = rollout.cut(found.step)
            base = subject.rollout(rollout, alone=True)
        for heap in range(1, 4):
            fresh = Conditions(fresh=True, heap=heap)
            if (again := _diverge(base, subject.rerun(rollout.under(fresh)), info)) is not None:
                yield self._found(subject, "EC202", rollout, fresh, again)
                return
        subject.prefetch((rollout.under(conditions) for _, conditions, _ in alone), alone=True)
        for code, conditions, _ in alone:
            if (again := _diverge(base, subject.rollout(rollout.under(conditions), alone=True), info)) is not None:
                reported = True
                runs = (subject.rerun(rollout.under(conditions)) for _ in range(_CONFIRMED))
                if all(_diverge(base, run, info) is None for run in runs):
                    # It differs by chance, which no condition controls, such as numbers from the operating system.
                    yield self._found(subject, "EC201", rollout, Conditions(again=True), again)
                    return
                if again.field == "info":
                    code = _TELEMETRY.get(code, code)
                if conditions.before:
                    conditions, again = self._fewer(subject, rollout, base, conditions, again, info)
                yield self._found(subject, code, rollout, conditions, again)
                if code == "EC205":
                    # Earlier episodes and other instances take time, so they would differ for the same reason.
                    return
        if found is not None and not reported:
            yield self._found(subject, "EC206", rollout, together, found)

    def _raised(
        self, subject: Subject, rollout: Rollout, alone: list[tuple[str, Conditions, str]], info: bool
    ) -> Iterator[Finding]:
        """Findings about unusual actions that let step() raise where it does not in the plain episode."""
        base = subject.rollout(rollout, alone=True)
        for code, conditions, name in alone:
            if name in _HABITS:
                trace = subject.rollout(rollout.under(conditions), alone=True)
                again = _diverge(base, trace, info)
                if again is not None and base.fault is None and trace.fault is not None:
                    yield self._found(subject, code, rollout, conditions, again)

    def _after_many(self, subject: Subject) -> Iterator[Finding]:
        """Compare what the session repeats with the same episode in a process of its own."""
        last = subject.session.trace
        plain = last.rollout.under(Conditions())
        subject.rollout(plain, alone=True)
        before = [Episode(episode.seed, episode.actions) for episode in last.rollout.conditions.before]
        repeated = [(number, last.before[number]) for number in subject.session.repetitions]
        for info in (True, False):
            # Consecutive episodes also show what every second reset undoes.
            differing = (
                number
                for number, trace in [*repeated, (len(last.before), last)]
                if _diverge(subject.rollout(plain.cut(len(trace.rollout.actions)), alone=True), trace, info) is not None
            )
            if (number := next(differing, None)) is None:
                return
            short = plain if number == len(last.before) else plain.cut(len(before[number].actions))
            base = subject.rollout(short, alone=True)
            conditions = Conditions(before=before[:number])
            found = _diverge(base, subject.rollout(short.under(conditions), alone=True), info)
            if found is None:
                return
            code = _TELEMETRY["EC206"] if found.field == "info" else "EC206"
            conditions, found = self._fewer(subject, short, base, conditions, found, info)
            yield self._found(subject, code, short, conditions, found)
            if code == "EC206":
                return

    def _fewer(
        self, subject: Subject, rollout: Rollout, base: Trace, conditions: Conditions, found: Divergence, info: bool
    ) -> tuple[Conditions, Divergence]:
        """Reduce the earlier episodes to a few that still change the trace: first by all steps, then by halves,
        quarters … of the episodes at the start or the end.
        """
        tries = _TRIES

        def shows(before: list[Episode]) -> bool:
            nonlocal conditions, found, tries
            steps = sum(len(episode.actions) for episode in before) + len(rollout.actions)
            if not before or tries <= 0 or not (subject.affords(steps) or len(before) == 1):
                return False
            tries -= 1
            fewer = Conditions(before=before)
            again = _diverge(base, subject.rollout(rollout.under(fewer), alone=True), info)
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

    def _reset_again(self, subject: Subject, rollout: Rollout, info: bool) -> Divergence | None:
        """How a repeated reset differs from the first; None if none does.

        Repetitions share a process, which is quick. Only if one differs, each runs in a process of its own.
        """
        first = subject.rerun(rollout, alone=False)
        repeated = (subject.rerun(rollout, alone=False) for _ in range(_RESETS))
        differs = any(_diverge(first, trace, info) is not None for trace in repeated)
        return self._redraw(subject, rollout, _REPEATS, info) if differs else None

    def _redraw(self, subject: Subject, rollout: Rollout, times: int, info: bool) -> Divergence | None:
        """How one of `times` repetitions differs from the first run; None if none does."""
        first = subject.rollout(rollout, alone=True)
        repeated = (_diverge(first, subject.rerun(rollout), info) for _ in range(times))
        return next((found for found in repeated if found is not None), None)

    def _together(self, subject: Subject, rollout: Rollout, left_out: frozenset[str] = frozenset()) -> Conditions:
        """All conditions at the same time, without those `left_out`."""
        alone = [each for each in self._alone(subject, rollout) if each[2] not in left_out]
        return msgspec.structs.replace(
            Conditions(fresh=True, heap=1, hash_seed=_OTHER_HASHES),
            **{name: getattr(conditions, name) for _, conditions, name in alone if name != "hash_seed"},
        )

    def _alone(self, subject: Subject, rollout: Rollout) -> list[tuple[str, Conditions, str]]:
        """Each condition alone: the code of its finding, the condition, and its field."""
        from envcraft.judging import actions

        seed = rollout.seed + 8_009
        beside = Episode(seed, actions.random_actions(subject.action_space, seed, subject.budget.beside))
        before = subject.probes.earlier(rollout, subject.searches.best(), subject.episodes.idle)
        rendered = [("EC208", Conditions(render=True), "render")] if self._renders(subject) else []
        taken = "options" in subject.load().description.get("reset", ("options",))
        optional = [("EC214", Conditions(options=True), "options")] if taken else []
        return [
            ("EC203", Conditions(hash_seed=_OTHER_HASHES), "hash_seed"),
            ("EC204", Conditions(global_seed=_OTHER_STATE, perturb=_OTHER_STATE), "perturb"),
            ("EC205", Conditions(clock=_SHIFTED), "clock"),
            ("EC206", Conditions(before=before), "before"),
            ("EC207", Conditions(companion=beside), "companion"),
            *rendered,
            *optional,
            *_habits(subject.action_space),
        ]

    def _renders(self, subject: Subject) -> bool:
        """Whether render() can be called: one that raises would end every episode of all conditions together."""
        if not subject.renders:
            return False
        fault = subject.rendered().fault
        return fault is None or fault.phase != "render"

    def _attribute_repeat(self, subject: Subject, rollout: Rollout, found: Divergence, info: bool) -> Finding:
        """Name the cause of a difference between plain repetitions: the clock, the process, or the run itself."""
        short = rollout.cut(found.step)
        logical = short.under(Conditions(clock=_LOGICAL))
        first = subject.rerun(logical)
        if all(_diverge(first, subject.rerun(logical), info) is None for _ in range(_REPEATS)):
            # Addresses change only in some runs, so all of them may have been equal by chance.
            moved = (short.under(Conditions(clock=_LOGICAL, heap=heap)) for heap in range(1, 4))
            if any(_diverge(first, subject.rerun(other), info) is not None for other in moved):
                return self._found(subject, "EC202", rollout, Conditions(fresh=True, heap=1), found)
            code = _TELEMETRY["EC205"] if found.field == "info" else "EC205"
            return self._found(subject, code, rollout, Conditions(clock=_SHIFTED), found)
        again = Conditions(again=True)
        for _ in range(_REPEATS):
            twice = subject.rerun(short.under(again))
            within = _diverge(twice.earlier, twice, info) if twice.earlier is not None else found
            if within is not None:
                break
        else:
            return self._found(subject, "EC202", rollout, Conditions(fresh=True, heap=1), found)
        return self._found(subject, "EC201", rollout, again, within)

    def _found(
        self, subject: Subject, code: str, rollout: Rollout, conditions: Conditions, divergence: Divergence
    ) -> Finding:
        how = {
            "EC201": "when it is run again in the same process",
            "EC202": "in a fresh process",
            "EC203": "under another PYTHONHASHSEED",
            "EC204": "with the global random generators in another state",
            "EC205": "under another clock",
            "EC206": f"after {plural(len(conditions.before), 'other episode')} on the same instance",
            "EC207": "with a second instance stepped alongside",
            "EC208": "with render() between the steps",
            "EC210": "under another clock",
            "EC214": "with empty options",
            "EC215": "with one action array that the caller overwrites for each step",
            "EC216": "with actions of another integer type",
            "EC218": "with actions as lists",
            "EC211": f"after {plural(len(conditions.before), 'other episode')} on the same instance",
        }[code]
        line = subject.line_of("step" if divergence.step else "reset")
        return self.finding(
            code,
            f"seed {rollout.seed} gives another trace {how}: {divergence}",
            line=line,
            repro=repro(rollout.cut(divergence.step).under(conditions)),
            step=divergence.step,
            field=divergence.field,
            first=divergence.first,
            second=divergence.second,
        )

    def _judge_seeds(self, subject: Subject) -> Iterator[Finding]:
        first = subject.probes.random(0)
        # Most seeds differ at once.
        for length in (_SEEDED_STEPS, subject.budget.probes[1]):
            seeds = [subject.probes.episode_seed(number) for number in range(3)]
            same = [msgspec.structs.replace(first.cut(length), seed=seed) for seed in seeds]
            traces = subject.rollouts(same)
            if any(_diverge(traces[0], trace, info=False) is not None for trace in traces[1:]):
                return
        if not any(trace.opaque for trace in traces):
            yield self.finding(
                "EC209",
                f"the seeds {seeds} give the same frames, rewards and flags, which is fine for one fixed level",
                line=subject.line_of("reset"),
                repro=repro(same[0].cut(20)),
                seeds=seeds,
            )

    def _judge_unseeded(self, subject: Subject, fixed: bool) -> Iterator[Finding]:
        """Judge unseeded episodes that follow a seeded one. `fixed` says that all seeds give the same episode."""
        plain = subject.probes.random(0).cut(_UNSEEDED_STEPS)

        def after(count: int) -> Rollout:
            before = [Episode(plain.seed, plain.actions), *[Episode(None, plain.actions)] * count]
            return plain.under(Conditions(before=before, unseeded=True))

        first = subject.rollout(after(0))
        if first.opaque or not first.usable:
            return
        again = (subject.rerun(after(0), alone=False) for _ in range(_UNSEEDED_AGAIN))
        if any(_diverge(first, trace, info=False) is not None for trace in again):
            alone = subject.rerun(after(0))
            if (found := _diverge(alone, subject.rerun(after(0)), info=False)) is not None:
                words = (
                    f"after reset(seed={plain.seed}) and an episode, reset() gives another episode in each run: {found}"
                )
                small = repro(after(0).cut(found.step))
                yield self.finding("EC213", words, line=subject.line_of("reset"), repro=small, step=found.step)
                return
        later = (subject.rollout(after(count)) for count in range(1, _UNSEEDED + 1))
        if fixed or not all(_diverge(first, trace, info=False) is None for trace in later):
            return
        seeded = [
            msgspec.structs.replace(plain, seed=subject.probes.random(number).seed) for number in range(_UNSEEDED)
        ]
        traces = subject.rollouts(seeded)
        different = sum(_diverge(traces[0], trace, info=False) is not None for trace in traces)
        if 2 * different > _UNSEEDED:
            words = f"after reset(seed={plain.seed}) all {_UNSEEDED + 1} resets without a seed give the same episode, "
            words += f"while {_UNSEEDED} seeds give {different + 1} different ones"
            yield self.finding("EC212", words, line=subject.line_of("reset"), repro=repro(after(1)))


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


def _diverge(first: Trace, second: Trace, info: bool) -> Divergence | None:
    from envcraft.model.job import ExitReason
    from envcraft.model.trace import diverge

    if _interrupted(first) or _interrupted(second):
        return None
    found = diverge(first, second, info)
    # A busy machine misses deadlines. The check sandbox reports a call that misses them repeatedly.
    late = any(trace.end is not None and trace.end.reason is ExitReason.TIMEOUT for trace in (first, second))
    return None if found is not None and found.field == "length" and late else found


def _interrupted(trace: Trace) -> bool:
    """Whether a call that is only part of a condition raised, which the check api reports."""
    calls = ["earlier reset", "before", "companion", "render"]
    if trace.rollout.conditions.options:
        calls.append("reset")
    return trace.fault is not None and trace.fault.phase in calls


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Determinism()]
