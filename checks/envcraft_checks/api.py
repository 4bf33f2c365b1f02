"""# api

## What it does
Holds every value of every episode against the contract: both spaces, what `reset` takes and returns, the five parts of
`step`, type, dtype, shape and range of each observation, `info`, `render()`, `close()` twice and before any reset, an
instance that is made after another one was closed, a second reset, and one with `seed=None` and `options=None`, as
wrappers call it. Looks whether a returned observation changes in the next four steps or by the next reset, and whether
`step` writes into the action.

Exceptions are searched for: random play, held buttons, every action at every step in rotation, rare actions on
copies of the states of the longest episode and of the last ones on the way to a win, and an exploration that returns
to states seldom left.

## Why is this bad?
Agents batch, store and replay what an environment returns. One frame of another shape at the end of an episode, or a
buffer that is overwritten later, corrupts a replay memory without any error; one rare exception ends a training run
after days.

## Example
```python
def step(self, action):
    self.canvas[:] = 0          # EC110: the observation returned last time changes too
    ...
    return self.canvas, reward, terminated, truncated, {}
```
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.check import Check, Rule
from envcraft.plugins import hookimpl
from envcraft.rollout import Conditions, Rollout
from envcraft.shrink import repro, shrink
from envcraft.verdict import Finding

from .source import ask_for_dependency

if TYPE_CHECKING:
    from envcraft.description import Outcome
    from envcraft.subject import Subject
    from envcraft.trace import Fault, Trace

_INSPECT = Conditions(reread=True, options=True, closed=True)
_RENDER = Conditions(render=True)
_INSPECTED = 200
_CALLS = {
    "reset": "EC104", "earlier reset": "EC104", "plain reset": "EC104", "step": "EC107", "before": "EC107",
    "render": "EC112", "close": "EC113", "early close": "EC113",
}  # fmt: skip
#: Phases that are calls of a method with another name, or with arguments that matter.
_NAMES = {
    "earlier reset": "reset()",
    "plain reset": "reset(seed=None, options=None)",
    "early close": "close() before reset()",
    "before": "step() in an earlier episode on the same instance",
}

#: What graphics libraries say where there is no screen: nothing about the environment.
_NO_SCREEN = re.compile(r"OpenGL|\bGL context|gladLoad|\bdisplay\b|\bEGL\b|OSMesa|GLFW", re.IGNORECASE)


class Api(Check):
    name = "api"
    rules = (
        Rule(
            "EC101",
            "observation-space",
            "The observation space is not the contract's.",
            "Declare the contract's space.",
        ),
        Rule("EC102", "action-space", "The action space is not the contract's.", "Declare the contract's space."),
        Rule(
            "EC103",
            "reset-parameters",
            "reset() does not take seed= and options=.",
            "Write `def reset(self, *, seed=None, options=None)`.",
        ),
        Rule("EC104", "reset-raises", "reset() raises.", "Mend the line that is named."),
        Rule("EC105", "reset-result", "reset() does not return (observation, info).", "Return both."),
        Rule(
            "EC106",
            "step-result",
            "step() does not return five values.",
            "Return observation, reward, two flags, info.",
        ),
        Rule("EC107", "step-raises", "step() raises.", "Mend the line that is named; the reproduction reaches it."),
        Rule(
            "EC108",
            "observation-type",
            "An observation has the wrong type, dtype or shape.",
            "Convert before returning it.",
        ),
        Rule("EC109", "observation-range", "An observation lies outside its space.", "Clip it, or widen the space."),
        Rule(
            "EC110",
            "observation-aliased",
            "An observation changes after it was returned.",
            "Return `frame.copy()`, or draw each frame into a new array.",
        ),
        Rule("EC111", "action-modified", "step() writes into the action array.", "Work on a copy of the action."),
        Rule("EC112", "render", "render() raises or gives no frame.", "Return the frame for render_mode rgb_array."),
        Rule(
            "EC113",
            "close-raises",
            "close() raises: before a reset, the first or the second time.",
            "Let close() free what is this instance's and is there, and do nothing twice.",
        ),
        Rule("EC114", "info", "info is no dict with str keys.", "Return a dict, empty if need be."),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        yield from self._judge_spaces(subject)
        if "seed" not in subject.load().description.get("reset", ("seed",)):
            return
        seen: set[str] = set()
        for trace in self._traces(subject):
            for finding in self.find(subject, trace):
                if finding.code not in seen:
                    seen.add(finding.code)
                    yield self._smallest(subject, trace, finding)
            if seen & {"EC104", "EC105"}:
                return
        if "EC107" not in seen and (crash := self._search_crash(subject)) is not None:
            yield self._smallest(subject, crash, next(self.find(subject, crash)))

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code in ("EC101", "EC102", "EC103"):
            found = self._judge_spaces(subject)
        else:
            conditions = Conditions.from_json(finding.repro.conditions)
            found = self.find(subject, subject.rollout(Rollout(finding.repro.seed, finding.repro.actions, conditions)))
        return next((again for again in found if again.code == finding.code), None)

    def _judge_spaces(self, subject: Subject) -> Iterator[Finding]:
        from envcraft import spaces

        told = subject.load().description
        for code, name, promised in (
            ("EC101", "observation_space", subject.contract.observation),
            ("EC102", "action_space", subject.contract.action),
        ):
            given = told.get(name)
            if not isinstance(given, dict) or "type" not in given:
                continue
            if promised is None and given["type"] not in spaces.KNOWN and not given.get("custom"):
                yield self.finding(
                    code, f"{name} is {given['type']}, no space of Gymnasium", line=subject.line_of("__init__")
                )
            elif promised is not None and not spaces.same(promised, given):
                words = f"{name} is {spaces.describe(given)}, not {spaces.describe(promised)}"
                yield self.finding(code, words, line=subject.line_of("__init__"), given=given)
        if "reset" in told and set(told["reset"]) != {"seed", "options"}:
            lacking = " and ".join(name + "=" for name in ("seed", "options") if name not in told["reset"])
            yield self.finding("EC103", f"reset() does not take {lacking}", line=subject.line_of("reset"))

    def _traces(self, subject: Subject) -> Iterator[Trace]:
        """What every kind of play gives, the cheapest first, so that a plain defect is found at once."""
        players = subject.players
        first = players.random(0)
        told = subject.load().description
        base = first.cut(_INSPECTED)
        inspect = msgspec.structs.replace(_INSPECT, options="options" in told.get("reset", ("options",)))
        rollouts = [first, base.under(inspect)]
        if subject.renders:
            rollouts.append(base.under(_RENDER))
        subject.foresee(rollouts)
        # The longest jobs are not left to the end, where they would run alone.
        subject.foresee(subject.searches.explorations())
        rollouts += [*players.all, *players.rotations]
        subject.foresee(rollouts)
        yield from map(subject.rollout, rollouts)
        found = subject.searches.best()
        later = [base.cut(5).under(Conditions(before=players.earlier(base, found)))]
        if found is not None:
            later += [found.under(conditions) for conditions in ([_RENDER] if subject.renders else []) + [inspect]]
        yield from subject.rollouts(later)

    def _search_crash(self, subject: Subject) -> Trace | None:
        """A trace that ends in an exception, found by search and confirmed by a rollout."""
        for number in range(subject.budget.explore[1]):
            if actions := subject.searches.explore(number).get("crash"):
                trace = subject.searches.scripted(number, actions, "exploration")
                if trace.fault is not None:
                    return trace
        left = subject.budget.sweep
        if not left:
            return None
        explored = [trace for trace in subject.searches.explored() if trace.usable]
        if explored:
            # Some states are only met on the way to a win.
            best = max(explored, key=lambda trace: (trace.positive, trace.total))
            told = subject.searches.sweep_last(best.actions, best.rollout.seed, left // 2)
            if (crash := self._rare(subject, best, told)) is not None:
                return crash
            left -= min(max(told.get("steps", 0), 0), left // 2)
        longest = max(
            (trace for trace in subject.played() if trace.usable), key=lambda trace: trace.steps, default=None
        )
        reached = min((trace.steps for trace in subject.rollouts(subject.players.rotations)), default=0)
        # Where each rotation lives as long, every action has been tried at every step already.
        if longest is None or reached >= longest.steps:
            return None
        return self._rare(subject, longest, subject.searches.sweep(longest.actions, longest.rollout.seed, left))

    def _rare(self, subject: Subject, path: Trace, told: Outcome) -> Trace | None:
        trace = subject.rollout(Rollout(path.rollout.seed, list(told.get("crash") or []), player="a rare action"))
        return trace if trace.fault is not None else None

    def find(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        """What is wrong with the values of one trace."""
        who = trace.rollout.player
        if trace.fault is not None and not trace.fault.memory:
            finding = self._judge_fault(subject, trace, trace.fault)
            if finding is not None:
                yield finding
        for kind, code in (("type", "EC108"), ("range", "EC109")):
            problem = next((problem for problem in trace.problems if problem.kind == kind), None)
            if problem is None:
                continue
            yield self.finding(code, f"{problem.words} ({_at(problem.step)}, under {who})", step=problem.step)
        if trace.overwritten:
            at, by = trace.overwritten[0]
            words = f"the observation of {_at(at)} had changed after {'the next reset' if by is None else f'step {by}'}"
            # What is said of a step that came later may show at once, in an episode that ends there.
            yield self.finding("EC110", words, line=subject.line_of("reset" if by is None else "step"), step=at + 1)
        if trace.acted:
            step, now = trace.acted[0]
            words = f"step {step} changed its action to {str(now)[:200]}"
            yield self.finding("EC111", words, line=subject.line_of("step"), step=step)
        for problem in trace.render_problems:
            if problem.kind == "type":
                yield self.finding("EC112", problem.words, line=subject.line_of("render"), step=problem.step)
                break
        for step, note in trace.info_notes[:1]:
            what = f"is a {note['type']}" if "type" in note else f"has a key of type {note.get('key')}"
            yield self.finding("EC114", f"info {what} ({_at(step)}, under {who})", step=step)

    def _judge_fault(self, subject: Subject, trace: Trace, fault: Fault) -> Finding | None:
        ask_for_dependency(subject, fault)
        line = fault.line or subject.line_of("step" if fault.phase == "before" else fault.phase.rpartition(" ")[2])
        after = trace.rollout.conditions.closed and fault.phase != "early close"
        closed = ", after another instance was closed" if after else ""
        if fault.malformed:
            code = "EC105" if fault.phase == "reset" else "EC106"
            words = f"{fault.phase}() returned {fault.malformed} ({_at(fault.step)})"
            return self.finding(code, words, line=line, step=fault.step)
        if closed and fault.phase == "construct":
            return self.finding("EC113", f"no instance can be made{closed}: {fault}", line=line)
        if fault.phase not in _CALLS:
            return None
        if fault.phase == "render" and _NO_SCREEN.search(f"{fault.type} {fault.message}"):
            return None
        code = _CALLS[fault.phase]
        where = f"step {fault.step}" if fault.phase == "step" else _NAMES.get(fault.phase, f"{fault.phase}()")
        words = f"{where} raises {fault} (under {trace.rollout.player}{closed})"
        raised: dict[str, Any] = {"type": fault.type, "traceback": fault.traceback, **trace.printed}
        return self.finding(code, words, line=line, step=fault.step, **raised)

    def _smallest(self, subject: Subject, trace: Trace, finding: Finding) -> Finding:
        """The finding with a reproduction that is as short and as idle as a few tries make it."""

        def shows(rollout: Rollout) -> bool:
            return any(found.code == finding.code for found in self.find(subject, subject.rollout(rollout)))

        rollout = trace.rollout
        apart = rollout.under(msgspec.structs.replace(rollout.conditions, closed=False))
        if rollout.conditions.closed and shows(apart):
            rollout = apart
        small = shrink(rollout, finding.evidence.get("step", trace.steps), shows, subject.contract.noop)
        # It may show at another step than the first time.
        again = (found for found in self.find(subject, subject.rollout(small)) if found.code == finding.code)
        return msgspec.structs.replace(next(again, finding), repro=repro(small))


def _at(step: int) -> str:
    return "the reset" if step == 0 else f"step {step}"


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Api()]
