"""# api

## What it does
Compares every value of every episode with the contract: both spaces, the parameters and result of `reset`, the five
values of `step`, the type, dtype, shape and range of each observation, `info`, `render()`, and `close()` twice and
before the first reset. It also resets once more after an episode, calls `reset(seed=None, options=None)` as wrappers
do, and constructs an instance after another one was closed. An environment that defines `render` must follow
Gymnasium's conventions for it.

In every episode the check compares each action before and after `step`, and each observation that the environment still
refers to with what was returned. In one episode it keeps all observations, as a replay memory does, and also compares
them after the next reset. It reads the spaces again after the reset, after 1, 2, 4, 8 … steps and at the end. A space
may be a new object if it is equal.

The check searches for exceptions: it plays random actions, holds single actions, plays all actions in rotation,
continues after a success, a reward or a loss, and explores from states in which few actions were tried. It also tries
rare actions on copies of the states of the longest episode and of the last states before a win.

An observation that is outside its space only after earlier episodes follows from what these leave behind. The check
reports it only if the check determinism does not report that.

## Why is this bad?
Agents batch, store and replay the values that an environment returns. One frame of another shape at the end of an
episode, or a buffer that is overwritten later, corrupts a replay memory without any error. One rare exception ends a
training run after days.

## Example
```python
def step(self, action):
    self.canvas[:] = 0          # EC110: the observation returned last time changes too
    ...
    return self.canvas, reward, terminated, truncated, {}
```
"""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.errors import Skip
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import shrunk
from envcraft.model import phases
from envcraft.model.contract import OPTIONAL
from envcraft.model.rollout import Conditions, Episode, Rollout
from envcraft.model.verdict import Finding, Repro, Severity
from envcraft.plugins import hookimpl
from envcraft.text import with_article

from .interface.lines import (
    acting_line,
    declared,
    line_of_result,
    line_of_space,
    lines_of_call,
    misspelt_space,
    overwriting_line,
)
from .libraries import ask_for_dependency

if TYPE_CHECKING:
    from envcraft.judging.description import Rendering
    from envcraft.judging.subject import Subject
    from envcraft.model.job import SearchOutcome
    from envcraft.model.trace import Fault, Trace
    from envcraft.model.verdict import CheckReport

_RENDER = Conditions(render=True)
_CALLS = {
    "reset": "EC104", "earlier reset": "EC104", "plain reset": "EC104", "step": "EC107", "before": "EC107",
    "render": "EC112", "close": "EC113", "early close": "EC113", "spaces": "EC115",
}  # fmt: skip
#: What Gymnasium calls keys of metadata that Gym had.
_NEW_KEYS = {"render.modes": "render_modes", "video.frames_per_second": "render_fps"}
#: Messages of graphics libraries on a machine without a screen. They say nothing about the environment.
_NO_SCREEN = re.compile(r"OpenGL|\bGL context|gladLoad|\bdisplay\b|\bEGL\b|OSMesa|GLFW", re.IGNORECASE)
#: The place in the result of the value that a code is about.
_RETURNED = {"EC108": 0, "EC109": 0, "EC114": -1}
#: The most earlier episodes that are played alone.
_ALONE = 4


class Api(Check):
    name = "api"
    rules = (
        Rule(
            "EC101",
            "observation-space",
            "The observation space is not the contract's.",
            "Declare a space that the contract allows, or name another contract with --contract.",
            gate=True,
        ),
        Rule(
            "EC102",
            "action-space",
            "The action space is not the contract's.",
            "Declare a space that the contract allows, or name another contract with --contract.",
            gate=True,
        ),
        Rule(
            "EC103",
            "reset-parameters",
            "reset() does not take seed= and options=.",
            "Declare `def reset(self, *, seed=None, options=None)`.",
        ),
        Rule(
            "EC104",
            "reset-raises",
            "reset() raises.",
            "Fix the line that raises: the finding's, or that of another file that its message names.",
        ),
        Rule(
            "EC105",
            "reset-result",
            "reset() does not return (observation, info).",
            "Return the observation and a dictionary: `return observation, {}`.",
        ),
        Rule(
            "EC106",
            "step-result",
            "step() does not return five values.",
            "Return observation, reward, two flags, info.",
        ),
        Rule(
            "EC107",
            "step-raises",
            "step() raises.",
            "Fix the line that raises: the finding's, or that of another file that its message names.",
        ),
        Rule(
            "EC108",
            "observation-type",
            "An observation has the wrong type, dtype or shape.",
            "Return what the space declares: its keys, and the type, dtype and shape of each value.",
        ),
        Rule("EC109", "observation-range", "An observation is outside its space.", "Clip it, or widen the space."),
        Rule(
            "EC110",
            "observation-aliased",
            "An observation changes after it was returned.",
            "Return a copy: `self.state.copy()` of an array, `copy.deepcopy(self.state)` of a dict of arrays.",
        ),
        Rule("EC111", "action-modified", "step() writes into the action array.", "Work on a copy of the action."),
        Rule(
            "EC112",
            "render",
            "render() raises or returns no frame.",
            "Fix the line that raises, or return the frame for render_mode rgb_array.",
            waiver='render = "optional"',
        ),
        Rule(
            "EC113",
            "close-raises",
            "close() raises: before a reset, after an episode, or at the second call.",
            "In close(), free only resources that this instance has opened, and allow a second call.",
        ),
        Rule(
            "EC114",
            "info",
            "info is not a dict with str keys, or its success is not a bool.",
            "Return a dict; it may be empty.",
        ),
        Rule(
            "EC115",
            "space-changes",
            "A space changes during play, or cannot be read.",
            "Define both spaces once, in the constructor, for all levels and episodes.",
        ),
        Rule(
            "EC116",
            "render-conventions",
            "The environment lacks metadata or arguments that Gymnasium needs to render it.",
            "Take render_mode and store it, and declare metadata = "
            '{"render_modes": [the modes of render()], "render_fps": 30}.',
            Severity.WARNING,
        ),
        Rule(
            "EC117",
            "render-mode-dropped",
            "The constructor takes render_mode and does not store it.",
            "Set `self.render_mode = render_mode`: wrappers such as RecordVideo refuse an environment without it.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        spaces = list(self._judge_spaces(subject))
        yield from spaces
        if spaces:
            return
        lost = _lost_mode(subject)
        held: list[Finding] = []
        for finding in self._judge_conventions(subject):
            if finding.code == "EC116" and finding.message == lost:
                held.append(finding)
            else:
                yield finding
        for finding in self._judge_play(subject):
            yield finding
            if lost and finding.message.endswith(lost):
                # The lost mode has done more harm than a warning says.
                held.clear()
        yield from held

    def _judge_play(self, subject: Subject) -> Iterator[Finding]:
        """Judge the traces of every kind of play, one finding a code."""
        if "seed" not in subject.load().description.get("reset", ("seed",)):
            return
        seen: set[str] = set()
        for trace in self._traces(subject):
            for finding in self.find(subject, trace):
                if finding.code not in seen and not self._outlives(subject, trace, finding):
                    seen.add(finding.code)
                    yield _placed(subject, self._smallest(subject, trace, finding))
            if seen & {"EC104", "EC105"}:
                return
        if "EC107" not in seen and (crash := self._search_crash(subject)) is not None:
            # The crash may be none of this check's: one for lack of memory belongs to the check sandbox.
            for finding in itertools.islice(self.find(subject, crash), 1):
                if finding.code not in seen:
                    yield self._smallest(subject, crash, finding)

    def _outlives(self, subject: Subject, trace: Trace, finding: Finding) -> bool:
        """Whether an observation leaves its space only after earlier episodes, so that what they leave behind is the
        defect.
        """
        if finding.code != "EC109" or not trace.rollout.conditions.before:
            return False
        alone = subject.rollout(trace.rollout.cut(finding.evidence["step"]).under(Conditions()))
        return all(again.code != finding.code for again in self.find(subject, alone))

    def conclude(self, subject: Subject, reports: Sequence[CheckReport]) -> Iterator[Finding]:
        shown = {finding.code for report in reports for finding in [*report.findings, *report.known]}
        if not shown.isdisjoint({"EC109", "EC115", "EC206", "EC207"}):
            return
        for trace in subject.traces:
            if any(problem.kind == "range" for problem in trace.problems):
                found = (finding for finding in self.find(subject, trace) if finding.code == "EC109")
                yield from (self._smallest(subject, trace, finding) for finding in found)
                return

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        again = next((again for again in self._found_again(subject, finding.repro) if again.code == finding.code), None)
        return _placed(subject, again) if again is not None else None

    def _found_again(self, subject: Subject, repro: Repro) -> Iterator[Finding]:
        """The findings that need no episode, then those of the episode of a reproduction."""
        yield from self._judge_spaces(subject)
        yield from self._judge_conventions(subject)
        conditions = Conditions.from_json(repro.conditions)
        yield from self.find(subject, subject.rollout(Rollout(repro.seed, repro.actions, conditions)))

    def _judge_spaces(self, subject: Subject) -> Iterator[Finding]:
        """Compare the declared spaces with the contract's."""
        from envcraft.judging.fit import fitting_contract
        from envcraft.spaces.spec import Unknown, difference, read_space

        description = subject.load().description
        for code, name, promised in (
            ("EC101", "observation_space", subject.contract.observation),
            ("EC102", "action_space", subject.contract.action),
        ):
            if (given := description.get(name)) is None:
                continue
            space = read_space(given)
            if isinstance(space, Unknown) and space.name == "NoneType":
                words = f"{subject.env_class or subject.target.path} has no {name}"
                if (misspelt := misspelt_space(subject, name)) is not None:
                    other, number = misspelt
                    yield self.finding(code, f"{words}, but {other}; correct this name", line=number)
                else:
                    yield self.finding(code, f"{words}; set it in __init__", line=subject.line_of("__init__"))
            elif promised is None and isinstance(space, Unknown) and not space.custom:
                yield self.finding(
                    code, f"{name} is {space}, which is not a Gymnasium space", line=line_of_space(subject, name)
                )
            elif promised is not None and space != (expected := read_space(promised)):
                fits = fitting_contract(description, subject.contract)
                hint = f"; its spaces fit another contract: --contract {fits}" if fits else ""
                place, *texts = difference(space, expected)
                words = f"{name}{place} is {texts[0]}, not {texts[1]}{hint}"
                yield self.finding(code, words, line=line_of_space(subject, name), given=given, fits=fits)

    def _judge_conventions(self, subject: Subject) -> Iterator[Finding]:
        """Judge the parameters of reset() and what wrappers that render expect."""
        description = subject.load().description
        yield from self._judge_rendering(subject)
        if "reset" in description and set(description["reset"]) != {"seed", "options"}:
            missing = " and ".join(name + "=" for name in ("seed", "options") if name not in description["reset"])
            yield self.finding("EC103", f"reset() does not take {missing}", line=subject.line_of("reset"))

    def _judge_rendering(self, subject: Subject) -> Iterator[Finding]:
        description, line = subject.load().description, subject.line_of("__init__")
        rendering, modes = description.get("rendering"), description.get("render_modes", [])
        if rendering is None or not description.get("renders"):
            return
        given, kept = rendering["given"], rendering["kept"]
        required = subject.contract.render not in (False, OPTIONAL)
        wrong: list[str] = []
        lacking: list[str] = []
        if not rendering["takes"] and (required or modes):
            wrong.append("the constructor does not take render_mode")
        elif words := _lost_mode(subject):
            if required:
                yield self.finding("EC117", words, line=line, given=given, kept=kept)
            else:
                wrong.append(words)
        if not modes:
            lacking.append(_renamed(rendering, "render.modes") or 'metadata["render_modes"] is empty or absent')
        elif required and "rgb_array" not in modes:
            lacking.append(f'metadata["render_modes"] is {modes}, without rgb_array')
        if not rendering["rate"]:
            words = 'metadata has no "render_fps", which Gymnasium expects beside "render_modes"'
            lacking.append(_renamed(rendering, "video.frames_per_second") or words)
        if wrong or lacking:
            lines = declared(subject, "metadata")[:1] if lacking else [line]
            place = lines[0] if lines else subject.line_of()
            yield self.finding("EC116", "; ".join([*wrong, *lacking]), line=place)

    def _traces(self, subject: Subject) -> Iterator[Trace]:
        """The traces of every kind of play, the cheapest first, so that a simple defect is reported at once."""
        probes, episodes = subject.probes, subject.episodes
        base = probes.random(0).cut(subject.budget.inspected)
        rendered = base.cut(subject.budget.inspected // 2).under(_RENDER)
        subject.prefetch([probes.random(0)], alone=True)
        subject.prefetch([subject.inspected(base), *([rendered] if subject.renders else [])])
        yield episodes.whole[0]
        yield subject.rollout(subject.inspected(base))
        if subject.renders:
            yield subject.rollout(rendered)
        yield from itertools.chain(episodes.whole[1:], episodes.all, episodes.rotations)
        yield from subject.searches.onward
        found = subject.searches.best()
        yield from subject.searches.explored()
        before = probes.earlier(base.cut(5), None, episodes.idle)
        if found is not None:
            before = [*[Episode(found.rollout.seed, found.actions)] * (1 + found.positive), *before]
        yield subject.rollout(base.cut(5).under(Conditions(before=before)))
        yield subject.session.trace
        if found is not None and (found.positive or subject.budget.rotations):
            yield subject.rollout(subject.inspected(found.rollout.cut(found.steps)))
            if subject.renders and (trace := subject.rendered_best()) is not None:
                yield trace
        # A policy that goes wrong is not a reason to skip this check.
        with contextlib.suppress(Skip):
            yield from subject.privileged()

    def _search_crash(self, subject: Subject) -> Trace | None:
        """The rollout of an action sequence that raises, from a search; None if no search ends in an exception."""
        for number, outcome in enumerate(subject.searches.explorations):
            if actions := outcome.get("crash"):
                trace = subject.searches.scripted(number, actions, "exploration")
                if trace.fault is not None:
                    return trace
        left = subject.searches.sweep_steps
        if not left:
            return None
        explored = [trace for trace in subject.searches.explored() if trace.usable]
        if explored:
            # Only play that comes near a win reaches some states.
            best = max(explored, key=lambda trace: (trace.positive, trace.total))
            outcome = subject.searches.sweep_last(best.actions, best.rollout.seed, left // 2)
            if (crash := self._rare(subject, best, outcome)) is not None:
                return crash
            left -= min(max(outcome.get("steps", 0), 0), left // 2)
        longest = max(
            (trace for trace in subject.played() if trace.usable), key=lambda trace: trace.steps, default=None
        )
        reached = min((trace.steps for trace in subject.episodes.rotations), default=0)
        # If each rotation lasts as long, it has tried every action at every step already.
        if longest is None or reached >= longest.steps:
            return None
        return self._rare(subject, longest, subject.searches.sweep(longest.actions, longest.rollout.seed, left))

    def _rare(self, subject: Subject, path: Trace, outcome: SearchOutcome) -> Trace | None:
        actions = list(outcome.get("crash") or [])
        trace = subject.rollout(Rollout(path.rollout.seed, actions, player="a search for rare actions"))
        return trace if trace.fault is not None else None

    def find(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        """Judge the values of one trace."""
        who = trace.rollout.player
        if trace.fault is not None and not trace.fault.memory:
            finding = self._judge_fault(subject, trace, trace.fault)
            if finding is not None:
                yield finding
        for kind, code in (("type", "EC108"), ("range", "EC109")):
            problem = next((problem for problem in trace.problems if problem.kind == kind), None)
            if problem is None:
                continue
            line = line_of_result(subject, "step" if problem.step else "reset", 0)
            yield self.finding(
                code, f"{problem.words} ({_at(problem.step)}, under {who})", line=line, step=problem.step
            )
        if trace.overwritten:
            at, by = trace.overwritten[0]
            later = "the next reset" if by is None else f"step {by}" if by > at else "it was returned"
            words = f"the observation of {_at(at)} changed after {later}"
            # A change that is noticed later may show at once in an episode that ends here.
            line = overwriting_line(subject, "reset" if by is None else "step")
            yield self.finding("EC110", words, line=line, step=at + 1, by=trace.steps if by is None else by)
        if trace.acted:
            step, now = trace.acted[0]
            words = f"step {step} changed its action to {str(now)[:200]}"
            yield self.finding("EC111", words, line=acting_line(subject), step=step)
        for change in trace.spaces[:1]:
            words = f"{change.name} is {change.now} at {_at(change.step)}, but was {change.before} before the reset"
            if change.now == change.before:
                words = f"{change.name} is {change.now} at {_at(change.step)}, with other bounds than before the reset"
            line = subject.line_of("step" if change.step else "reset")
            yield self.finding("EC115", f"{words} (under {who})", line=line, step=change.step)
        # A picture of another dtype than the space has, which is the observation, too, is reported as that.
        twice = any(problem.kind == "type" for problem in trace.problems)
        for problem in trace.render_problems:
            if problem.kind == "type" or (problem.kind == "format" and not twice):
                own = "NoneType" in problem.words and not subject.line_of("render").note
                lost = _lost_mode(subject) if own else ""
                line = subject.line_of("__init__") if lost else line_of_result(subject, "render")
                words = f"{problem.words}: {lost}" if lost else problem.words
                found = self.finding("EC112", words, line=line, step=problem.step)
                # Gymnasium's own checker only warns of another kind of picture.
                yield found if problem.kind == "type" else found.as_warning()
                break
        for step, note in trace.info_notes[:1]:
            what = f"is {with_article(note['type'])}" if "type" in note else f"has a key of type {note.get('key')}"
            line = line_of_result(subject, "step" if step else "reset", -1)
            yield self.finding("EC114", f"info {what} ({_at(step)}, under {who})", line=line, step=step)
        key = trace.rule.key
        for step in (0, trace.steps) if len(trace.infos) == trace.steps + 1 else ():
            value = trace.info(step).get(key)
            if isinstance(value, str | list | dict):
                line = line_of_result(subject, "step" if step else "reset", -1)
                words = f"info[{key!r}] is {with_article(type(value).__name__)}, not a bool ({_at(step)}, under {who})"
                yield self.finding("EC114", words, line=line, step=step)
                break

    def _judge_fault(self, subject: Subject, trace: Trace, fault: Fault) -> Finding | None:
        ask_for_dependency(subject, fault)
        line = fault.line or subject.line_of("step" if fault.phase == "before" else fault.phase.rpartition(" ")[2])
        after = trace.rollout.conditions.closed and fault.phase != "early close"
        closed = ", after another instance was closed" if after else ""
        if fault.malformed:
            method = {"earlier reset": "reset", "before": "step"}.get(fault.phase, fault.phase)
            line = line_of_result(subject, method)
            code = "EC105" if method == "reset" else "EC106"
            words = f"{method}() returned {fault.malformed} ({_at(fault.step)})"
            return self.finding(code, words, line=line, step=fault.step)
        if closed and fault.phase == "construct":
            return self.finding("EC113", f"the constructor fails{closed}: {subject.raised(fault)}", line=line)
        if fault.phase not in _CALLS:
            return None
        if fault.phase == "render" and _NO_SCREEN.search(f"{fault.type} {fault.message}"):
            return None
        code = _CALLS[fault.phase]
        call = phases.in_words(fault.phase, fault.step)
        words = f"{call} raises {subject.raised(fault)} (under {trace.rollout.player}{closed})"
        raised: dict[str, Any] = {"type": fault.type, **fault.evidence, **trace.printed}
        return self.finding(code, words, line=line, step=fault.step, **raised)

    def _smallest(self, subject: Subject, trace: Trace, finding: Finding) -> Finding:
        """Replace a finding's reproduction by the shortest and idlest one that a few tries give."""

        def find(played: Trace) -> Iterator[Finding]:
            return self.find(subject, played)

        if trace.fault is not None and trace.fault.phase in ("before", "earlier reset"):
            for played in self._earlier_alone(subject, trace):
                again = next((each for each in find(played) if each.code == finding.code), None)
                if again is not None:
                    return shrunk(subject, played.rollout, again, find, bounded=False)
        step = finding.evidence.get("step", trace.steps)
        rollout = trace.rollout
        apart = rollout.under(msgspec.structs.replace(rollout.conditions, closed=False))
        if rollout.conditions.closed:
            found = find(subject.rollout(apart.cut(step + 1)))
            rollout = apart if any(each.code == finding.code for each in found) else rollout
        return shrunk(subject, rollout, finding, find, bounded=False)

    def _earlier_alone(self, subject: Subject, trace: Trace) -> Iterator[Trace]:
        """The first of the earlier episodes of a trace, or the failing one if it is known, each on an instance of its
        own.
        """
        before = [each for each in trace.rollout.conditions.before if each.seed is not None and each.actions]
        if trace.rollout.conditions.recorded and trace.fault is not None:
            # An episode whose reset raised is not among the recorded ones.
            failing = len(trace.before) - (trace.fault.phase == "before")
            before = trace.rollout.conditions.before[failing : failing + 1]
        for each in before[:_ALONE]:
            yield subject.rollout(Rollout(each.seed or 0, each.actions, player="an earlier episode"))


def _placed(subject: Subject, finding: Finding) -> Finding:
    """A finding about a value with the line that returned it, where a method returns at several."""
    step, part = finding.evidence.get("step"), _RETURNED.get(finding.code)
    method = "step" if step else "reset"
    if step is None or part is None or finding.line != subject.line_of(method).number:
        return finding
    line = line_of_result(subject, method, part, lines_of_call(subject, finding, step))
    return msgspec.structs.replace(finding, line=line) if isinstance(line, int) else finding


def _lost_mode(subject: Subject) -> str:
    """Which render_mode the environment has in place of the one that its constructor takes, in words; "" if it has
    that one.
    """
    rendering = subject.load().description.get("rendering")
    if rendering is None or not rendering["takes"] or rendering["given"] in (None, rendering["kept"]):
        return ""
    return f"the constructor receives render_mode={rendering['given']!r}, but then render_mode is {rendering['kept']!r}"


def _renamed(rendering: Rendering, key: str) -> str:
    """What is wrong with a key of metadata that has another name in Gymnasium; "" if the metadata does not have it."""
    return f'metadata has "{key}", which Gymnasium calls "{_NEW_KEYS[key]}"' if key in rendering["old"] else ""


def _at(step: int) -> str:
    return "the reset" if step == 0 else f"step {step}"


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Api()]
