"""# reward

## What it does
Checks every reward of every episode. A reward must be a real number of Python or NumPy (not an array, string, None or
bool), finite, and inside the contract's range for one step. Rewards grow without bound if their size rises over the
whole episode, under every policy, at least fourfold and to at least 1. The growth may start in the first half.

If `info["is_success"]` reports wins, the check compares the return of each win with the return of doing nothing on the
same seed. It warns if no win has a positive last reward, a positive return, or a higher return than doing nothing.
Step costs are fine: they make a win cheaper than idling to the end. If the contract names no action that does nothing,
the check warns only if no step of any play pays.

A reward that is zero in all play and all searches is an error if the code only ever returns zero, and the contract
counts a positive return as a win. Otherwise it is a warning if no success is reported, because play may not have
reached the reward. With `--policy FILE` the policy's episodes count, too.

The exploration also looks for loops: actions that lead back to the same picture and pay each time, and two actions in
turn that pay each time. A loop is farmable if repeating it in a plain episode earns clearly more than a success on that
seed within half of the longest episode. It is an error if the loop earns twice as much as every success that was
played, else a warning. If other seeds have a success and this one has none, the check reports nothing. If no play
succeeds at all, the reward of the loop may be the goal. The check then warns of a loop that leads back to the same
state of the game, in which only time has passed, and that earns clearly more in the longest episode than other play. It
is an error if the loop earns twice as much as all other play, and more than any number that the code adds to the
reward, and info reports no success up to the end.

A failure is an episode of one held action, or a loss that pays more than the step that wins. Failing pays more if a
failure earns clearly more than the step that wins and than every success on its seed that takes at most half as long,
and no success earns clearly more than the failure. It is an error if at least three successes show this, or two whose
last steps are punished, else a warning. Varied play that fails and collects more than a short success does not count,
because a better success may collect the same.

If most steps of a success pay, a search takes long to reach it. The check then plays the success once more without
detours: it leaves out the actions between two equal observations. Loops and failures are compared with this success,
too.

The line of a finding is the one that writes the reward, even if a method or a dictionary of the file contains it. If
there are several, the check plays the episode once more, and the worker records which lines each call runs. The finding
then names a line that ran in the call in question: for a NaN the line that divides or takes a logarithm, for a value
out of range the line that moved it out, and for excessive rewards the line that pays most. If the calls do not show the
line, it is that of `step`.

## Why is this bad?
One NaN turns every weight of a network into NaN. A rare reward of a million outweighs everything else that an agent
could learn, and a reward that grows with time teaches the agent to wait. An agent has no reason to learn a win that
pays nothing, or less than failing. It learns what pays most, not what the author wanted.

## Example
```python
reward = self.hits / self.shots      # EC301 before the first shot: 0 / 0 with NumPy numbers
reward = 0.01 * self.steps ** 2      # EC304
```
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro, shrunk
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.target import Kind
from envcraft.model.verdict import Finding, Line, Severity
from envcraft.plugins import hookimpl
from envcraft.text import plural, with_article

from .rewards.blame import blamed_line, reward_line
from .rewards.failing import failing_pays
from .rewards.farming import farmed
from .rewards.growth import falls, growth
from .rewards.successes import direct_successes, successes
from .rewards.zeros import pays_nothing

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_NUMBERS = ("int", "float", "numpy integer", "numpy floating")
_LONG = 80


class Reward(Check):
    name = "reward"
    rules = (
        Rule(
            "EC301", "not-finite", "A reward is NaN or infinite.", "Guard the division or logarithm that produces it."
        ),
        Rule(
            "EC302",
            "not-a-number",
            "A reward is not a real number.",
            "Give the reward an int or a float on every path; `float(reward)` converts an array of one number.",
        ),
        Rule(
            "EC303",
            "out-of-range",
            "A reward is outside the contract's range.",
            "Scale the rewards, or clip them.",
            waiver="reward-range = [LOW, HIGH]",
        ),
        Rule(
            "EC304",
            "grows-without-bound",
            "Rewards grow with the length of the episode under every policy.",
            "Do not multiply a reward by time.",
        ),
        Rule(
            "EC305",
            "win-unpaid",
            "Winning pays nothing.",
            "Pay for the success that info reports.",
            Severity.WARNING,
        ),
        Rule("EC306", "never-pays", "The reward is always zero.", "Return the reward that the game computes."),
        Rule(
            "EC307",
            "farmable",
            "A repeated loop of actions earns more than any success.",
            "Pay for progress once, or charge for the way back.",
        ),
        Rule(
            "EC308",
            "failing-pays-more",
            "An episode without success earns more than every success.",
            "Pay more for success than can be earned without it.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        traces = [*subject.played(), *subject.searches.explored()]
        if not any(trace.rewards for trace in traces):
            raise Undecided("no episode has a reward")
        seen: set[str] = set()
        for trace in traces:
            for finding in self.find(subject, trace):
                if finding.code not in seen:
                    seen.add(finding.code)
                    small = shrunk(subject, trace.rollout, finding, lambda played: self.find(subject, played))
                    same = str(small.evidence["reward"]) == str(finding.evidence["reward"])
                    yield _placed(subject, small, trace.rollout.cut(finding.evidence["step"]) if same else None)
        grown = [] if {"EC301", "EC303"} & seen else list(self._judge_growth(subject, traces))
        yield from (_placed(subject, finding) for finding in grown)
        if {"EC301", "EC302"} & seen:
            # Returns that are no numbers compare with nothing.
            return
        if (silent := self._judge_silence(subject, traces)) is not None:
            yield _placed(subject, silent)
            return
        unpaid = self._judge_wins(subject, traces)
        traces += direct_successes(subject, traces)
        failing = self._judge_failures(subject, traces)
        if failing is not None and not grown and (unpaid is None or failing.evidence["earned"] > 0):
            yield _placed(subject, failing)
        elif unpaid is not None:
            yield _placed(subject, unpaid)
        loop = None if grown else self._judge_loops(subject, traces)
        # Waiting that pays is a loop, too.
        if loop is not None and (failing is None or loop.severity is Severity.ERROR):
            yield _placed(subject, loop)

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code not in ("EC301", "EC302", "EC303"):
            return super().confirm(subject, finding)
        conditions = Conditions.from_json(finding.repro.conditions)
        trace = subject.rollout(Rollout(finding.repro.seed, finding.repro.actions, conditions))
        again = next((found for found in self.find(subject, trace) if found.code == finding.code), None)
        return _placed(subject, again, bounded=False) if again is not None else None

    def find(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        """Judge the single rewards of one trace, and report the first of each kind."""
        low, high = subject.contract.reward_range
        seen: set[str] = set()
        for step, (reward, kind) in enumerate(zip(trace.rewards, trace.reward_types, strict=True), 1):
            if kind not in _NUMBERS:
                code, words = "EC302", f"the reward of step {step} is {_kind(kind)}, not a number"
            elif not math.isfinite(reward):
                code, words = "EC301", f"the reward of step {step} is {reward}"
            elif not low <= reward <= high:
                code, words = "EC303", f"the reward of step {step} is {reward:g}, outside {low:g} to {high:g}"
            else:
                continue
            if code not in seen:
                seen.add(code)
                yield self.finding(
                    code,
                    f"{words} (under {trace.rollout.player})",
                    line=_line(subject),
                    repro=repro(trace.rollout.cut(step)),
                    step=step,
                    reward=reward,
                    kind=kind,
                )

    def _judge_growth(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        long = _long(traces)
        grown = {id(trace): ratio for trace in long if (ratio := growth(trace.rewards)) is not None}
        if late := len(grown) < len(long):
            if any(falls(trace.rewards) for trace in long):
                return
            # Growth may begin too late for those that are shorter, or cut.
            long = [trace for trace in long if trace.ended and 2 * trace.steps >= max(each.steps for each in long)]
        least = max((trace.steps for trace in long), default=0) // 2 if late else _LONG
        more = subject.episodes.more_whole()
        while long and all(id(trace) in grown for trace in long) and not _enough(long, late):
            if (trace := next(more, None)) is None:
                return
            if trace.usable and trace.steps >= least and trace not in long:
                long.append(trace)
                if (ratio := growth(trace.rewards)) is not None:
                    grown[id(trace)] = ratio
        # One action that is held soon changes nothing more, so a penalty for waiting grows in such episodes alone.
        varied = any(action != trace.actions[0] for trace in long for action in trace.actions)
        if varied and all(id(trace) in grown for trace in long):
            longest = max(long, key=lambda trace: trace.steps)
            sizes = [abs(reward) for reward in longest.rewards]
            yield self.finding(
                "EC304",
                f"rewards grow throughout each of {len(long)} long episodes under every policy: "
                f"at most {max(sizes[: _LONG // 2]):g} in the first {_LONG // 2} steps, "
                f"{max(sizes):g} by step {longest.steps}",
                line=subject.line_of("step"),
                repro=repro(longest.rollout.cut(longest.steps)),
                episodes=len(long),
                growth=min(grown[id(trace)] for trace in long),
            )

    def _judge_silence(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        if _pays(subject, traces):
            return None
        played, outcomes = [*traces, *subject.privileged()], subject.searches.explorations
        certain = subject.contract.success.sign and subject.target.kind is Kind.SOURCE and pays_nothing(subject.text)
        succeeds = any(trace.reported_success for trace in played) or any(outcome.get("win") for outcome in outcomes)
        if not certain and (succeeds or not all(trace.usable for trace in played)):
            return None
        longest = max(traces, key=lambda trace: trace.steps)
        searched = sum(int(outcome.get("steps") or 0) for outcome in outcomes)
        finding = self.finding(
            "EC306",
            f"the reward of every step is 0 in {len(played)} episodes and {searched:,} steps of exploration"
            f"{'' if succeeds else ', and no success is reported'}"
            f"{'; step() returns no other value' if certain else ''}",
            line=subject.line_of("step"),
            repro=repro(longest.rollout.cut(longest.steps)),
            episodes=len(played),
            certain=certain,
        )
        return finding if certain else finding.as_warning()

    def _judge_loops(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        if (found := farmed(subject, traces)) is None:
            return None
        finding = self.finding(
            "EC307",
            found.words,
            line=subject.line_of("step"),
            repro=repro(found.trace.rollout),
            **found.evidence,
        )
        return finding if found.certain else finding.as_warning()

    def _judge_failures(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        if (found := failing_pays(subject, traces)) is None:
            return None
        failure, success = found.failure, found.success
        finding = self.finding(
            "EC308",
            f"{failure.rollout.player} earns {failure.total:g} in {plural(failure.steps, 'step')} without success, "
            f"while success on the same seed earns {success.total:g} in {plural(success.steps, 'step')}; {found.shown} "
            f"of {found.won} successes earn clearly less than a failure on their seed, and none earns clearly more",
            line=subject.line_of("step"),
            repro=repro(failure.rollout.cut(failure.steps)),
            earned=failure.total,
            success=success.total,
            successes=found.shown,
        )
        return finding if found.certain else finding.as_warning()

    def _judge_wins(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        won = successes(traces)
        if not won:
            return None
        shown = min(won, key=lambda trace: trace.steps)
        paid = f"winning pays {shown.total:g} in {plural(shown.steps, 'step')} (under {shown.rollout.player})"
        line, again = subject.line_of("step"), repro(shown.rollout.cut(shown.steps))
        if subject.contract.noop is None:
            if _pays(subject, traces):
                return None
            words = f"{paid}, and the reward of every step is 0 in all {len(traces)} episodes, {len(won)} of them won"
            return self.finding("EC305", words, line=line, repro=again, won=len(won))
        if any(not trace.total <= 0 or not trace.rewards[-1] <= 0 for trace in won):
            return None
        idled: dict[int, Trace] = {}
        for trace in won:
            seed = trace.rollout.seed
            if seed not in idled:
                idled[seed] = subject.rollout(msgspec.structs.replace(subject.probes.noop(), seed=seed))
            # If idling wins as well, the reward is for losing.
            if not idled[seed].usable or idled[seed].reported_success or trace.total > idled[seed].total:
                return None
        words = (
            f"{paid}, and doing nothing pays {idled[shown.rollout.seed].total:g} on the same seed; none of the "
            f"{len(won)} won episodes pays more"
        )
        return self.finding("EC305", words, line=line, repro=again, won=len(won))


def _kind(kind: str) -> str:
    """A kind of values in a sentence: ``a str``, ``None``."""
    return {"None": kind, "another type": "of another type"}.get(kind) or with_article(kind)


def _line(subject: Subject) -> int | Line:
    """The line that writes the reward if there is one such line, else that of step()."""
    own = subject.target.kind is Kind.SOURCE
    return (reward_line(subject.text, subject.class_statement) if own else None) or subject.line_of("step")


def _placed(subject: Subject, finding: Finding, episode: Rollout | None = None, bounded: bool = True) -> Finding:
    """A finding with the line that causes it, if the calls of its episode tell which of several does.

    Args:
        subject: the environment.
        finding: what an episode shows.
        episode: a longer one that shows the same at its last step.
        bounded: whether it is played only if the budget has its steps left.
    """
    line = blamed_line(subject, finding, episode, bounded)
    return finding if line is None else msgspec.structs.replace(finding, line=line)


def _pays(subject: Subject, traces: list[Trace]) -> bool:
    """Whether a step of any episode or search pays, as far as is known."""
    if any(any(trace.rewards) for trace in [*traces, *subject.privileged()]):
        return True
    return any(outcome.get("paid", 1) for outcome in subject.searches.explorations)


def _long(traces: list[Trace]) -> list[Trace]:
    return [trace for trace in traces if trace.usable and trace.steps >= _LONG]


def _enough(long: list[Trace], late: bool) -> bool:
    """Whether so many episodes show growth; if it begins late, under varied actions on two seeds, too."""
    varied = {trace.rollout.seed for trace in long if len({str(action) for action in trace.actions}) > 1}
    return len(long) >= 3 and (not late or len(varied) > 1)


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Reward()]
