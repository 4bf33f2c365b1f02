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
state of the game, in which only time has passed, and that earns clearly more in the longest episode than other play.

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
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

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
from .rewards.cycles import TIMES, leads_back
from .rewards.zeros import pays_nothing

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_NUMBERS = ("int", "float", "numpy integer", "numpy floating")
_LONG = 80
_PARTS = 8
_GROWTH = 4.0
#: Most games pay rewards of this size.
_USUAL = 1.0
#: The share by which a return must exceed a success, the fewest repetitions of a loop, and the successes of an error.
_CLEARLY, _REPEATS, _SUCCESSES = 0.25, 4, 3
#: How many times more than every success a loop earns where that is an error.
_FAR = 2
#: The share of the longest episode within which a success comes soon.
_SOON = 0.5


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
        traces += _direct_successes(subject, traces)
        failing = self._judge_failures(subject, traces)
        if failing is not None and not grown and (unpaid is None or failing.evidence["earned"] > 0):
            yield _placed(subject, failing)
        elif unpaid is not None:
            yield _placed(subject, unpaid)
        for finding in [] if grown else self._judge_loops(subject, traces):
            # Waiting that pays is a loop, too.
            if failing is None or finding.severity is Severity.ERROR:
                yield _placed(subject, finding)

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
            if any(_falls(trace.rewards) for trace in long):
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

    def _judge_loops(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        best = _best_soon(traces, max(trace.steps for trace in traces))
        won = _successes([*traces, *subject.privileged()])
        if not won and not any(outcome.get("win") for outcome in subject.searches.explorations):
            yield from self._judge_cycles(subject, traces)
            return
        most = max((trace.total for trace in won), default=0.0)
        for number, actions, size in subject.searches.loops:
            success = best.get(subject.episode_seed(number))
            if success is None or not subject.affords(len(actions)):
                continue
            trace = self._repeated(subject, number, actions, size, success)
            if trace is None:
                continue
            start = len(actions) - size
            whole = range(start, start + (trace.steps - start) // size * size, size)
            least = min((sum(trace.rewards[at : at + size]) for at in whole), default=0.0)
            if least <= 0:
                continue
            finding = self.finding(
                "EC307",
                f"repeating {_in_words(actions[-size:])} pays at least {least:g} each time, without success: "
                f"{trace.total:g} in {plural(trace.steps, 'step')}, while success on the same seed pays "
                f"{success.total:g} in {plural(success.steps, 'step')}",
                line=subject.line_of("step"),
                repro=repro(trace.rollout),
                loop=actions[-size:],
                gain=least,
                earned=trace.total,
                success=most,
            )
            yield finding if trace.total >= _FAR * max(most, 0) else finding.as_warning()
            return

    def _judge_cycles(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        """Report a loop where no play succeeds: it pays on and on and leads back to the same state, and no other play
        earns as much.
        """
        most, longest = max(trace.total for trace in traces), max(trace.steps for trace in traces)
        for number, actions, size in subject.searches.loops:
            trace = leads_back(subject, number, actions, size)
            if trace is None:
                continue
            first = len(actions) - size
            least = min(sum(trace.rewards[at : at + size]) for at in range(first, trace.steps, size))
            earned = trace.total + least * max(longest - trace.steps, 0) / size
            if least > 0 and earned >= clearly_more(most):
                yield self.finding(
                    "EC307",
                    f"repeating {_in_words(actions[-size:])} pays at least {least:g} each time, {TIMES} times in a "
                    f"row, and leads back to the same state; this earns {earned:g} in {plural(longest, 'step')}, while "
                    f"no episode succeeds or earns more than {most:g}",
                    line=subject.line_of("step"),
                    repro=repro(trace.rollout),
                    loop=actions[-size:],
                    gain=least,
                    earned=earned,
                    most=most,
                ).as_warning()
                return

    def _repeated(self, subject: Subject, number: int, actions: list[Any], size: int, success: Trace) -> Trace | None:
        """An episode that repeats a loop to its end, or until it earns clearly more than success; None if it succeeds,
        is lost, or earns less.
        """
        once = subject.searches.scripted(number, actions, "a loop of actions")
        gain, left = sum(once.rewards[-size:]), subject.length - len(actions)
        if not once.usable or once.ended or gain <= 0:
            return None
        least = clearly_more(success.total)
        repeats = max(math.ceil((least - once.total) / gain) + 1, _REPEATS)
        if repeats * size > left:
            return None
        if subject.affords(subject.length):
            repeats = left // size
        elif not subject.affords(repeats * size + len(actions)):
            return None
        trace = subject.searches.scripted(number, [*actions, *actions[-size:] * repeats], "a loop of actions")
        lost = trace.ended and trace.terminated[-1]
        if not trace.usable or trace.reported_success or lost or trace.total < least:
            return None
        return trace

    def _judge_failures(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        won = _successes(traces)
        pays = max((trace.rewards[-1] for trace in won), default=0.0)
        shown: list[tuple[Trace, Trace]] = []
        for seed in dict.fromkeys(trace.rollout.seed for trace in won):
            same = [trace for trace in won if trace.rollout.seed == seed]
            failed = [trace for trace in subject.played() if trace.rollout.seed == seed and _fails(trace, pays)]
            idle = subject.contract.noop is not None and not any(_is_idle(trace) for trace in failed)
            if idle and subject.affords(subject.length):
                trace = subject.rollout(msgspec.structs.replace(subject.probes.noop(), seed=seed))
                failed += [trace] if _fails(trace, pays) else []
            if not failed:
                return None
            failure = max(failed, key=lambda trace: trace.total)
            # A success that comes late shares what waiting for it pays; a loss that is paid pays in one step.
            paid = failure.terminated[-1] and failure.rewards[-1] > pays
            soon = [trace for trace in same if paid or trace.steps <= failure.steps * _SOON]
            if any(failure.total < clearly_more(max(trace.total, pays)) for trace in soon):
                return None
            if any(trace.total > clearly_more(failure.total) for trace in same):
                return None
            shown += [(failure, trace) for trace in soon]
        if not shown:
            return None
        failure, success = max(shown, key=lambda pair: pair[0].total - pair[1].total)
        finding = self.finding(
            "EC308",
            f"{failure.rollout.player} earns {failure.total:g} in {plural(failure.steps, 'step')} without success, "
            f"while success on the same seed earns {success.total:g} in {plural(success.steps, 'step')}; {len(shown)} "
            f"of {len(won)} successes earn clearly less than a failure on their seed, and none earns clearly more",
            line=subject.line_of("step"),
            repro=repro(failure.rollout.cut(failure.steps)),
            earned=failure.total,
            success=success.total,
            successes=len(shown),
        )
        usual = Counter(reward for trace in traces for reward in trace.rewards).most_common(1)[0][0]
        punished = len(shown) > 1 and pays < min(usual, 0.0)
        return finding if punished or len(shown) >= _SUCCESSES else finding.as_warning()

    def _judge_wins(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        won = _successes(traces)
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


def _successes(traces: list[Trace]) -> list[Trace]:
    """The episodes that end with reported success, each once."""
    return list({trace.rollout.key(): trace for trace in traces if trace.ended and trace.reported_success}.values())


def _best_soon(traces: list[Trace], limit: int) -> dict[int, Trace]:
    """The success with the highest return on each seed, of those that come soon if there are any."""
    best: dict[int, Trace] = {}
    for trace in _successes(traces):
        known = best.setdefault(trace.rollout.seed, trace)
        worth = [(each.steps <= limit * _SOON, each.total) for each in (trace, known)]
        if worth[0] > worth[1]:
            best[trace.rollout.seed] = trace
    return best


def _direct_successes(subject: Subject, traces: list[Trace]) -> list[Trace]:
    """Successes without detours, on seeds where steps pay and no success comes soon.

    A search follows what pays, so where each step does, it comes to a success late, if at all. Actions that lead back
    to the same observation are left out.
    """
    limit = max(trace.steps for trace in traces) * _SOON
    soonest: dict[int, Trace] = {}
    for trace in sorted(_successes(traces), key=lambda trace: trace.steps):
        soonest.setdefault(trace.rollout.seed, trace)
    found = []
    for trace in soonest.values():
        if trace.steps > limit and not trace.opaque and sum(reward > 0 for reward in trace.rewards) > trace.steps / 2:
            actions = _without_detours(trace)
            if len(actions) <= limit and subject.affords(len(actions)):
                player = f"{trace.rollout.player} without detours"
                found.append(subject.rollout(Rollout(trace.rollout.seed, actions, player=player)))
    return [trace for trace in found if trace.usable]


def _without_detours(trace: Trace) -> list[Any]:
    """The actions of an episode, without those between two equal observations."""
    last = {observation: step for step, observation in enumerate(trace.observations[: trace.steps])}
    actions, step = [], 0
    while step < trace.steps:
        step = last[trace.observations[step]]
        actions.append(trace.actions[step])
        step += 1
    return actions


def _fails(trace: Trace, pays: float) -> bool:
    """Whether an episode ends without success although it holds one action, or with a loss that pays more than the
    step that wins `pays`.
    """
    if not trace.ended or trace.reported_success:
        return False
    return len({str(action) for action in trace.actions}) == 1 or (trace.terminated[-1] and trace.rewards[-1] > pays)


def _is_idle(trace: Trace) -> bool:
    return trace.rollout.player == "doing nothing"


def clearly_more(earned: float) -> float:
    """The least return that is clearly more than another."""
    return earned + max(_CLEARLY * abs(earned), 1e-6)


def _in_words(actions: list[Any]) -> str:
    if len({str(action) for action in actions}) > 1:
        return str(actions)
    return str(actions[0]) if len(actions) == 1 else f"{actions[0]} {len(actions)} times"


def _long(traces: list[Trace]) -> list[Trace]:
    return [trace for trace in traces if trace.usable and trace.steps >= _LONG]


def _enough(long: list[Trace], late: bool) -> bool:
    """Whether so many episodes show growth; if it begins late, under varied actions on two seeds, too."""
    varied = {trace.rollout.seed for trace in long if len({str(action) for action in trace.actions}) > 1}
    return len(long) >= 3 and (not late or len(varied) > 1)


def growth(rewards: list[float]) -> float | None:
    """How many times larger rewards are in the last eighth of an episode than in the first eighth that pays.

    Args:
        rewards: all rewards of an episode, shape ``(steps,)``.

    Returns:
        The ratio; None if some eighth does not exceed the one before, if growth starts in the second half, or if the
        ratio or the last rewards are small.
    """
    sizes = _sizes(rewards)
    paid = sizes[next((number for number, size in enumerate(sizes) if size), _PARTS) :]
    if len(paid) < _PARTS // 2 or any(later <= earlier for earlier, later in pairwise(paid)):
        return None
    ratio = paid[-1] / paid[0]
    return ratio if ratio >= _GROWTH and paid[-1] >= _USUAL else None


def _falls(rewards: list[float]) -> bool:
    return any(later < earlier for earlier, later in pairwise(_sizes(rewards)))


def _sizes(rewards: list[float]) -> list[float]:
    """The median size of rewards in each eighth of an episode: single large rewards do not count."""
    part = len(rewards) // _PARTS
    parts = (sorted(map(abs, rewards[number * part : (number + 1) * part])) for number in range(_PARTS))
    return [window[len(window) // 2] for window in parts]


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Reward()]
