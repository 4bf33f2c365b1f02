"""# determinism

## What it does
Plays the same seed and actions again and compares whole traces bit by bit: frames, rewards, flags and info. The first
repetition runs in another process. The second changes all conditions at the same time: a new worker with another
PYTHONHASHSEED, global random generators in another state, a shifted and faster clock, empty options, earlier episodes
on the same instance, a second instance that is stepped alongside, `render()` between the steps, and actions as other
callers pass them: in one array that they overwrite for each step, as int32, and as Python's ints and lists where the
action space contains these. If the earlier episodes or the second instance raise an exception, the check compares
without them.

If this trace differs and the code reads the clock, the check first holds the clock: the clock is the cause if moving it
changes the trace, and nothing else about the process does while it is held. Otherwise the check tries each condition
alone. If none of them shows the difference, it tries a very fast clock, and then leaves out each condition that the
difference does not need. The finding names the condition, the first step and the field, with the part of an observation
or the key of info that differs. It also names the lines that depend on the condition: lines that draw from global
generators, read the clock, use the order of a set, or write state that episodes or instances share.

Then the check plays both runs once more and compares their states after each step: the attributes of the environment
and of its objects, class attributes, globals of the module, default arguments and random generators. The finding names
what differs first, with both values, and the line that writes it: `self.speed differs first, after step 3: 0.25 and
0.75, and line 41 writes it`. It does not name what also differs between two equal runs, such as the time of day. If
several fields differ after the same step, it names the one from which the others are calculated. What instances share
also outlives the episode: EC207 alone reports it, and names the file of the project that changes it.

The line of a finding is the first that is known of these: the only line that writes the key of info; the line that
draws, reads or writes what differs first; the first of the lines that depend on the condition; the line of `reset` or
`step`.

The episodes are random play and the best episode of a search, such as a win. The earlier episodes include the same
episode, the best one, a win several times, and one that does nothing until the end. Last, the check compares the first
steps of random play after many short episodes on the same instance. Other checks judge these episodes, too.

Different seeds must give different traces. One fixed level for every seed is a legitimate design and only a warning.
Training passes a seed only to the first reset. The episodes after it must be the same when the program runs again. They
must not all have the same level if different seeds give different levels, because an agent would train on one level.

`gymnasium.make` passes no render mode unless the caller names one. If the constructor has the default
`render_mode=None`, the first steps must be the same without a render mode as with `rgb_array`.

An info value that depends only on the clock, or counts the episodes, is telemetry and only a warning, unless it is the
contract's key for success. The check then compares again without info, so that telemetry does not hide other
differences.

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
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from envcraft.errors import Skip, Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl
from envcraft.text import plural
from envcraft_checks.comparing import causes, conditions, modes, places, seeds
from envcraft_checks.comparing.causes import REPEATS, TELEMETRY, Cause
from envcraft_checks.comparing.states import first_field, in_words
from envcraft_checks.comparing.traces import diverge, interrupted
from envcraft_checks.comparing.writers import SHARED, Writers, object_of
from envcraft_checks.linting.order import addresses
from envcraft_checks.linting.program import program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.verdict import CheckReport

#: Codes after which the comparison goes on without their cause.
_WARNINGS = {*TELEMETRY.values(), "EC218"}
#: Layouts of memory that are tried, and how many of them in workers of their own. Code that uses addresses needs more,
#: because few may leave them equal.
_LAYOUTS, _MORE_LAYOUTS = (6, 1), (12, 3)
#: Repetitions of a condition. At least one of them must differ again.
_CONFIRMED = 3


class Determinism(Check):
    name = "determinism"
    hash_seeds = (conditions.OTHER_HASHES,)
    rules = (
        Rule(
            "EC201",
            "run-again",
            "The same seed gives another trace when it is run again.",
            "Draw from self.np_random only, seeded by super().reset(seed=seed); do not depend on id().",
        ),
        Rule(
            "EC202",
            "fresh-process",
            "The trace depends on the process.",
            "Do not depend on id(), the process id, the order of a set of objects, or the memory of np.empty().",
        ),
        Rule(
            "EC203",
            "hash-seed",
            "The trace depends on PYTHONHASHSEED.",
            "Sort a set of strings before using its order; in place of hash(), use a number that each object keeps.",
        ),
        Rule(
            "EC204",
            "global-random",
            "The trace depends on the global state of random, numpy.random or torch.",
            "Draw from self.np_random, seeded by super().reset(seed=seed).",
        ),
        Rule("EC205", "clock", "The trace depends on the clock.", "Count steps instead of reading the time."),
        Rule(
            "EC206",
            "earlier-episodes",
            "The trace depends on earlier episodes.",
            "In reset(), set every attribute that step() changes, to a copy of what is kept; draw from self.np_random.",
            confirmed_by=("EC115",),
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
            "Call super().reset(seed=seed) and draw the level from self.np_random, unless one fixed level is intended.",
            Severity.WARNING,
        ),
        Rule(
            "EC210",
            "clock-in-info",
            "info depends on the clock.",
            "Remove it from info, unless it is telemetry that agents do not read.",
            Severity.WARNING,
        ),
        Rule(
            "EC211",
            "episodes-in-info",
            "info depends on earlier episodes.",
            "Remove it from info, unless it is a count of episodes that agents do not read.",
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
        Rule(
            "EC219",
            "render-mode",
            "The trace depends on whether the environment has a render mode.",
            "Draw observations in a method of its own, which step() and render() call.",
        ),
    )

    def __init__(self) -> None:
        #: The findings of EC206 whose cause EC207 reports, by subject.
        self._same: WeakKeyDictionary[Subject, list[Finding]] = WeakKeyDictionary()

    def conclude(self, subject: Subject, reports: Sequence[CheckReport]) -> list[Finding]:
        same = self._same.pop(subject, [])
        # The author may ignore EC207.
        shown = any(finding.code == "EC207" for report in reports for finding in [*report.findings, *report.known])
        if shown and subject.ignore_comments is not None:
            for finding in same:
                # The comment that ignores EC206 is not unused.
                subject.ignore_comments.take(finding)
        return [] if shown else same

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if subject.load().description.get("nondeterministic"):
            raise Skip("the environment is registered as nondeterministic")
        length = subject.budget.probes[1]
        plays = subject.episodes.probed
        reset = list(itertools.takewhile(lambda play: play.observations, plays))
        probes = [play.rollout.cut(min(length, max(play.steps, 1))) for play in reset]
        for rollout in probes:
            subject.prefetch([rollout, rollout.under(conditions.together(subject, rollout))], alone=True)
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
            raise Undecided(subject.without_reset(plays[len(reset)]))
        if not any(play.usable and play.steps for play in plays):
            raise Undecided("each episode raises an error or has no step")
        yield from modes.unrendered(self, subject)
        for rollout, cause in seeds.after_many(subject):
            if cause.code not in reported:
                yield self._found(subject, rollout, cause)
            if cause.code not in _WARNINGS:
                return
        info = not reported & set(TELEMETRY.values())
        if (differing := seeds.differing(subject, info)) is not None:
            more = self._apart(subject, self._compare(subject, differing, info))
            yield from (finding for finding in more if finding.code not in reported)
            if more:
                return
        fixed = list(seeds.ignored(self, subject))
        yield from fixed
        yield from (each for each in seeds.unseeded(self, subject, bool(fixed)) if each.code not in reported)
        stopped = next((trace.fault for trace in subject.traces if interrupted(trace)), None)
        if stopped is not None and not reported:
            why = stopped.type or stopped.malformed
            raise Undecided(f"a call under another condition fails ({why}), so not all traces could be compared")

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code == "EC209":
            return next(seeds.ignored(self, subject), None)
        under = Conditions.from_json(finding.repro.conditions)
        if finding.code == "EC219":
            return next(modes.unrendered(self, subject), None)
        if finding.code in ("EC212", "EC213") or under.unseeded:
            findings = seeds.unseeded(self, subject, fixed=False)
            return next((again for again in findings if again.code == finding.code), None)
        rollout = Rollout(finding.repro.seed, finding.repro.actions)
        info = finding.evidence.get("field") == "info"
        for _ in range(REPEATS):
            if under.again:
                trace = subject.rerun(rollout.under(under))
                found = diverge(trace.earlier, trace, info) if trace.earlier else None
            else:
                found = diverge(subject.rerun(rollout), subject.rerun(rollout.under(under)), info)
            if found is not None:
                return self._found(subject, rollout, Cause(finding.code, under, found))
        return None

    def _differs(self, subject: Subject, rollout: Rollout, left_out: frozenset[str]) -> bool:
        """Whether an episode differs when all conditions change at the same time."""
        everything = subject.rollout(rollout.under(conditions.together(subject, rollout, left_out)), alone=True)
        return interrupted(everything) or diverge(subject.rollout(rollout), everything, info=True) is not None

    def _probe(self, subject: Subject, rollout: Rollout, left_out: frozenset[str]) -> Iterator[Finding]:
        """Compare traces with info. Compare them again without what is only a warning, which may hide other
        differences: lists, and then info.
        """
        info = True
        while True:
            codes = set()
            for finding in self._apart(subject, self._compare(subject, rollout, info, left_out)):
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
        found = diverge(base, repeated, info) or causes.reset_again(subject, rollout.cut(0), info)
        if found is not None:
            yield self._found(subject, rollout, causes.of_repetitions(subject, rollout, found, info))
            return
        left_out |= conditions.interrupting(subject, rollout, left_out)
        together = conditions.together(subject, rollout, left_out)
        everything = subject.rollout(rollout.under(together), alone=True)
        found = diverge(base, everything, info)
        if found is None and not interrupted(everything):
            return
        alone = [each for each in conditions.alone(subject, rollout) if each[2] not in left_out]
        if found is not None and everything.fault is not None:
            # What raises at an unusual action does so at once, and needs no search for another cause.
            raised = list(self._raised(subject, rollout.cut(found.step), alone, info))
            yield from raised
            if raised:
                return
        if found is not None:
            if (clock := causes.by_reading(subject, rollout.cut(found.step), info)) is not None:
                yield self._found(subject, rollout, clock)
                return
            again = causes.redraw(subject, rollout.cut(found.step), REPEATS, info)
            if again is not None:
                yield self._found(subject, rollout, causes.of_repetitions(subject, rollout, again, info))
                return
        reported = False
        if found is not None:
            # Whichever condition causes it, the difference shows in these steps.
            rollout = rollout.cut(found.step)
            base = subject.rollout(rollout, alone=True)
        program = program_of(subject)
        layouts, workers = _LAYOUTS
        if program is not None and any(addresses(program)):
            layouts, workers = _MORE_LAYOUTS
        for heap in range(1, 1 + layouts):
            # In a worker of its own, the libraries lie elsewhere, too, but workers start slowly.
            fresh = Conditions(fresh=heap <= workers, heap=heap)
            if (again := diverge(base, subject.rerun(rollout.under(fresh)), info)) is not None:
                yield self._found(subject, rollout, Cause("EC202", fresh, again))
                return
        subject.prefetch((rollout.under(under) for _, under, _ in alone), alone=True)
        for code, under, _ in alone:
            if (again := diverge(base, subject.rollout(rollout.under(under), alone=True), info)) is not None:
                reported = True
                runs = [subject.rerun(rollout.under(under)) for _ in range(_CONFIRMED)]
                unsteady = any(diverge(runs[0], run, info) is not None for run in runs[1:])
                if unsteady and (plain := causes.redraw(subject, rollout, REPEATS, info)) is not None:
                    # The first repetitions of the plain episode were equal by chance.
                    yield self._found(subject, rollout, causes.of_repetitions(subject, rollout, plain, info))
                    return
                if all(diverge(base, run, info) is None for run in runs):
                    # It differs by chance, which no condition controls, such as numbers from the operating system.
                    chance = Cause("EC201", Conditions(again=True), again)
                    yield self._found(subject, rollout, causes.by_clock(subject, rollout, info) or chance)
                    return
                code = causes.code_of(subject, code, again)
                if under.before:
                    under, again = causes.fewer_episodes(subject, rollout, base, under, again, info)
                yield self._found(subject, rollout, Cause(code, under, again))
                if code == "EC205":
                    # Earlier episodes and other instances take time, so they would differ for the same reason.
                    return
        if found is not None and not reported:
            cause, parts = Cause("EC206", together, found), {name: code for code, _, name in alone}
            yield self._found(subject, rollout, causes.of_several(subject, rollout, base, cause, parts, info))

    def _apart(self, subject: Subject, found: Iterable[Finding]) -> list[Finding]:
        """Findings without the second of one cause: what instances share also outlives the episode."""
        findings = list(found)
        paths = [object_of(finding.evidence.get("state", {}).get("path", "self.")) for finding in findings]
        shared = {path for finding, path in zip(findings, paths, strict=True) if finding.code == "EC207"}
        same = [
            finding
            for finding, path in zip(findings, paths, strict=True)
            if finding.code == "EC206" and path in shared and not path.startswith("self.")
        ]
        if same:
            self._same[subject] = same
        return [finding for finding in findings if finding not in same]

    def _raised(
        self, subject: Subject, rollout: Rollout, alone: list[tuple[str, Conditions, str]], info: bool
    ) -> Iterator[Finding]:
        """Findings about unusual actions that let step() raise where it does not in the plain episode."""
        base = subject.rollout(rollout, alone=True)
        for code, under, name in alone:
            if name in conditions.HABITS:
                trace = subject.rollout(rollout.under(under), alone=True)
                again = diverge(base, trace, info)
                if again is not None and base.fault is None and trace.fault is not None:
                    yield self._found(subject, rollout, Cause(code, under, again))

    def _found(self, subject: Subject, rollout: Rollout, cause: Cause) -> Finding:
        code, under, divergence = cause
        divergence = places.located(subject, rollout, under, divergence)
        after = f"after {plural(len(under.before), 'other episode')} on the same instance"
        how = {
            "EC201": "when it is run again in the same process",
            "EC202": "in a fresh process",
            "EC203": "under another PYTHONHASHSEED",
            "EC204": "with the global random generators in another state",
            "EC205": "under another clock",
            "EC206": after,
            "EC207": "with a second instance stepped alongside",
            "EC208": "with render() between the steps",
            "EC210": "under another clock",
            "EC211": after,
            "EC214": "with empty options",
            "EC215": "with one action array that the caller overwrites for each step",
            "EC216": "with actions of another integer type",
            "EC218": "with actions as lists",
        }[code]
        writers = Writers(subject, code)
        field = first_field(subject, rollout, cause, writers)
        if field is not None:
            writers.follow(field.path)
        where, line = in_words(writers, field)
        evidence: dict[str, Any] = {"state": field.evidence} if field is not None else {}
        if writers.elsewhere is not None:
            file, suspects = writers.elsewhere
            evidence["lines"] = [f"{file}:{suspect.line}" for suspect in suspects]
        written = places.writing_line(subject, divergence)
        # The line that puts success into info is right; the state that it reads is not.
        line = line or written if code in SHARED else written or line
        return self.finding(
            code,
            f"seed {rollout.seed} gives another trace {how}: {divergence}{where}",
            line=line or subject.line_of("step" if divergence.step else "reset"),
            repro=repro(rollout.cut(divergence.step).under(under)),
            step=divergence.step,
            field=divergence.field,
            first=divergence.first,
            second=divergence.second,
            **evidence,
        )


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Determinism()]
