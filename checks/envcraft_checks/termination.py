"""# termination

## What it does
Plays random, held, idle and mixed episodes to the contract's limit, and goes on after a success, a large reward or a
loss. With `--policy FILE` it also plays the actions of the privileged policy. Each episode must end by itself by then.
The end at the limit must be `truncated`, not `terminated`. Flags must be booleans of Python or NumPy. A game whose
episodes all last at most five steps is allowed if its actions make a difference. Gymnasium leaves open what `step` does
after an episode's end, so flags that become false again are only a warning. It is an error if the reward of the end
comes a step late, because no agent receives it. The first step after the end, and no other one, then pays more than any
step of an episode, or it pays the same in five episodes whose last steps pay something else.

It also finds the step counter in the code. If nothing else limits an episode, play must not reset the counter, skip it
for some actions, or increase it past a number that it must equal.

A success must end the episode as `terminated`. If only `truncated` is set, the check looks for a longer episode on the
same seed, which shows that the end is not a time limit.

The same holds for a loss. It is reported if no episode is terminated without success, and many are truncated at
different steps of one seed, in the first half of the longest episode. It is an error if the last step of each of
them costs more than every step before it, else a warning: Gymnasium also truncates what leaves the bounds of its model.
A clock that starts again at each reward, such as hunger, is a time limit.

If info reports no success, an end at the limit that pays more than any step before it is a goal, such as survival, and
may be terminated. A game may have a rule that ends it at a fixed step before the contract's limit, such as a torch that
burns out. The check reports a time limit with swapped flags if all episodes that reach this step are terminated and all
shorter ones are truncated. It also does so if the code names the limit, such as `max_steps`, and truncates nothing.

Under a contract with a limit, success ends the episode. It is a defect if only time passes after the success: for at
least 30 steps of any play, no reward is paid, or doing nothing earns a reward at each step. A temporary success, such
as on a plate that opens a door, is fine.

A loss ends the episode, too. It is an error if an episode goes on after the step that costs most, and its rewards do
not change any more. For at least 150 steps, up to the limit if the budget allows, other actions must lead to the same
pictures and rewards. A player who is only stunned, or who appears again, acts sooner than that.

## Why is this bad?
An episode that never ends fills a replay memory with one situation and hangs evaluations. A time limit that is reported
as termination teaches the agent that no further reward can follow.

## Example
```python
terminated = self.lives == 0 or self.steps >= 1000   # EC502
truncated = False
```
"""

from __future__ import annotations

import ast
import itertools
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro, shrunk
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl
from envcraft.text import plural

from .linting.limits import terminates_at, unlimited
from .linting.program import in_words, line, program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_FLAGS = ("bool", "numpy.bool")
_PLAYABLE = 5
#: Steps of an episode that goes on after its success.
_AFTER_SUCCESS = 30
#: Steps without a change after which a held action is played to the end of its episode.
_STILL = 30
#: The fewest steps after a loss in which actions must change nothing, and the fewest actions that must be played there;
#: also the fewest lengths of episodes that a time limit does not explain.
_DEAD, _VARIED = 150, 3
#: The share of the longest episode within which one ends soon.
_SOON = 0.5
#: The values that step() returns.
_RESULTS = 5
#: How many times larger than each following one a reward is that is paid once, and the episodes that must be paid alike
#: after their end.
_TIMES, _OWING = 2, 5


class Termination(Check):
    name = "termination"
    rules = (
        Rule("EC501", "never-ends", "An episode does not end by the limit.", "Set truncated at the step limit."),
        Rule(
            "EC502",
            "limit-as-termination",
            "The time limit is reported as termination.",
            "Set truncated at the limit, and terminated only when the game itself ends.",
        ),
        Rule(
            "EC503",
            "ends-at-once",
            "Every episode ends before play is possible.",
            "Check the condition that ends an episode, and the state that reset() sets.",
        ),
        Rule("EC504", "flag-type", "terminated or truncated is not a boolean.", "Return `bool(...)`."),
        Rule(
            "EC505",
            "goes-on",
            "The episode continues after its end.",
            "Keep both flags unchanged until reset().",
            Severity.WARNING,
        ),
        Rule(
            "EC506",
            "success-does-not-end",
            "The episode goes on after its success.",
            "Set terminated at the step whose info reports success.",
        ),
        Rule(
            "EC507",
            "success-as-truncation",
            "A success ends the episode as truncated.",
            "Set terminated when the game is won, and truncated only at the step limit.",
        ),
        Rule(
            "EC508",
            "paid-after-end",
            "The largest reward is paid at the step after the end.",
            "Pay for the end in the step that sets terminated.",
        ),
        Rule(
            "EC509",
            "loss-does-not-end",
            "The episode goes on after it is lost.",
            "Set terminated at the step that loses the game.",
        ),
        Rule(
            "EC510",
            "loss-as-truncation",
            "A loss ends the episode as truncated.",
            "Set terminated when the game is lost, and truncated only at the step limit.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        traces = [*subject.played(), *subject.episodes.rotations[:4], *subject.searches.onward, *subject.privileged()]
        usable = [trace for trace in traces if trace.usable and trace.steps]
        if not usable:
            raise Undecided("each episode raises an error or has no step")
        flags = ((trace, finding) for trace in usable for finding in self._judge_flags(subject, trace))
        for trace, finding in itertools.islice(flags, 1):
            yield shrunk(subject, trace.rollout, finding, lambda played: self._judge_flags(subject, played))
        limit = subject.contract.limit
        if limit is not None:
            swapped = [*self._judge_limit(subject, usable, limit), *self._judge_own_limit(subject, usable, limit)]
            swapped = swapped or list(self._judge_named(subject, usable))
            yield from swapped or [*self._judge_truncated(subject, usable)] or self._judge_cut(subject, usable)
            if not any(finding.code == "EC501" for finding in swapped):
                yield from self._judge_code(subject, limit)
            yield from self._judge_success(subject)
            yield from self._judge_loss(subject, usable, limit)
        yield from self._judge_short(subject, usable)
        yield from self._judge_after(subject, usable)

    def _judge_flags(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        for step, kinds in enumerate(trace.flag_types, 1):
            for name, kind in zip(("terminated", "truncated"), kinds, strict=True):
                if kind not in _FLAGS:
                    yield self.finding(
                        "EC504",
                        f"{name} is {kind} at step {step}, not a bool (under {trace.rollout.player})",
                        line=subject.line_of("step"),
                        repro=repro(trace.rollout.cut(step)),
                        step=step,
                    )

    def _judge_limit(self, subject: Subject, traces: list[Trace], limit: int) -> Iterator[Finding]:
        if (still := self._standstill(subject)) is not None:
            traces = [*traces, still]
        endless = [trace for trace in traces if not trace.ended and trace.steps >= limit]
        if endless:
            players = list(dict.fromkeys(trace.rollout.player for trace in endless))
            yield self.finding(
                "EC501",
                f"{len(endless)} of {len(traces)} episodes do not end within {limit:,} steps: {', '.join(players[:4])}",
                line=subject.line_of("step"),
                repro=repro(endless[0].rollout),
                episodes=len(endless),
                of=len(traces),
            )
        # One episode may be lost at the last step by chance; several are ended by the limit.
        last = [trace for trace in traces if trace.ended and trace.steps == limit]
        if len(last) == 1 and self._is_mistaken(last[0]):
            last += [trace for trace in self._others(subject, last[0]) if trace.ended and trace.steps == limit]
        mistaken = [trace for trace in last if self._is_mistaken(trace)]
        if len(mistaken) >= 2 and len(mistaken) == len(last):
            yield self.finding(
                "EC502",
                f"all {len(mistaken)} episodes that reach step {limit} are terminated there, not truncated",
                line=subject.line_of("step"),
                repro=repro(mistaken[0].rollout),
                episodes=len(mistaken),
            )

    def _judge_named(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        """Report a limit of the game's own that the code calls a time limit, and that terminates all that reach it."""
        program = program_of(subject)
        named = terminates_at(program) if program is not None else None
        if named is None:
            return
        steps, suspect = named
        last = [trace for trace in traces if trace.ended and trace.steps == steps]
        if last and len({trace.rollout.seed for trace in last}) < 2 and subject.affords(steps):
            last += [trace for trace in self._others(subject, last[0]) if trace.ended and trace.steps == steps]
        # A game may punish who is too late, as a rule of its own.
        alike = all(self._is_mistaken(trace) and trace.rewards[-1] >= min(trace.rewards[:-1]) for trace in last)
        if alike and len({trace.rollout.seed for trace in last}) > 1:
            yield self.finding(
                "EC502",
                f"all {len(last)} episodes that reach step {steps} are terminated there, not truncated: line "
                f"{suspect.line} {suspect.words}",
                line=suspect.line,
                repro=repro(last[0].rollout.cut(steps)),
                episodes=len(last),
            )

    def _judge_code(self, subject: Subject, limit: int) -> Iterator[Finding]:
        """Report a step limit that the code lets play evade, where no episode has lasted long enough to show it."""
        program = program_of(subject)
        if program is None or "limit" in subject.contract.adapter:
            return
        suspects = list(unlimited(program, limit))
        if suspects:
            words, lines = in_words(suspects)
            yield self.finding(
                "EC501",
                f"{words}, so an episode can last longer than {limit:,} steps",
                line=suspects[0].line,
                lines=lines,
            )

    def _standstill(self, subject: Subject) -> Trace | None:
        """A whole episode of the first held action that stops all change, as a pause does; None if there is none."""
        for trace in subject.held():
            tail = trace.observations[-_STILL:]
            if not trace.ended and trace.usable and trace.steps >= _STILL and len(set(tail)) == 1:
                whole = subject.probes.hold(trace.rollout.actions[0])
                return subject.rollout(whole) if subject.affords(len(whole.actions)) else None
        return None

    def _judge_own_limit(self, subject: Subject, traces: list[Trace], limit: int) -> Iterator[Finding]:
        """Report a limit of the game's own with swapped flags: the longest episodes terminate, all others truncate."""
        longest = max(trace.steps for trace in traces)
        last = [trace for trace in traces if trace.steps == longest]
        short = [trace for trace in traces if trace.ended and trace.steps < longest]
        if longest >= limit or not all(map(self._is_mistaken, last)):
            return
        short += [trace for trace in subject.searches.explored() if trace.ended and trace.steps < longest]
        cut = all(trace.truncated[-1] and not trace.terminated[-1] for trace in short)
        if not cut or len({trace.steps for trace in short}) < 2:
            return
        if len({trace.rollout.seed for trace in last}) < 2:
            last += [trace for trace in self._others(subject, last[0]) if trace.steps == longest]
        if len({trace.rollout.seed for trace in last}) >= 2 and all(map(self._is_mistaken, last)):
            yield self.finding(
                "EC502",
                f"all {len(last)} episodes that reach step {longest} are terminated there, and all {len(short)} that "
                "end sooner are truncated",
                line=subject.line_of("step"),
                repro=repro(last[0].rollout.cut(longest)),
                episodes=len(last),
                sooner=len(short),
            )

    def _judge_success(self, subject: Subject) -> Iterator[Finding]:
        later = [(trace, step) for trace in subject.searches.onward if (step := _success(trace)) > 1]
        later = [(trace, step) for trace, step in later if trace.steps - step >= _AFTER_SUCCESS]
        if len(later) < 2 or any(trace.terminated[-1] for trace, _ in later) or not later[0][0].reported_success:
            return
        (idle, step), *_ = later
        paid = {reward for trace, at in later for reward in trace.rewards[at:]}
        again = set(idle.rewards[step:])
        if len(paid) == 1 and max(paid) <= 0 and all(trace.reported_success for trace, _ in later):
            words = "which pay nothing"
        elif len(again) == 1 and min(again) > 0 and subject.contract.noop is not None:
            words = f"and doing nothing earns {min(again):g} at each of them"
        else:
            return
        yield self.finding(
            "EC506",
            f"info reports success at step {step}, but the episode goes on for {idle.steps - step} more steps, {words}",
            line=subject.line_of("step"),
            repro=repro(idle.rollout.cut(step + _AFTER_SUCCESS)),
            step=step,
            episodes=len(later),
        )

    def _judge_loss(self, subject: Subject, traces: list[Trace], limit: int) -> Iterator[Finding]:
        """Report an episode that goes on after the step that costs most, though no action changes anything any more."""
        dead = [(trace, step) for trace in traces if (step := _over(trace))]
        for trace, step in sorted(dead, key=lambda each: each[1]):
            last = min(limit, trace.steps)
            if last < limit or any(_survives(other, trace.rewards[step - 1]) for other in traces):
                continue
            varied = len({str(action) for action in trace.actions[step:last]}) > _VARIED
            if not varied or len(set(trace.observations[step : last + 1])) > 1:
                # The end may be an animation, which other actions leave as it is.
                if not subject.affords(last):
                    continue
                other = subject.rollout(_otherwise(subject, trace, step, last))
                if not _alike(trace, other, step, last):
                    continue
            yield self.finding(
                "EC509",
                f"step {step} costs most, with a reward of {trace.rewards[step - 1]:g}, but the episode goes on for "
                f"{last - step} more steps in which actions change neither the observation nor the reward",
                line=subject.line_of("step"),
                repro=repro(trace.rollout.cut(last)),
                step=step,
                steps=last - step,
            )
            return

    def _judge_truncated(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        """Report a success whose only flag is truncated, though no time limit is there: other play goes on longer."""
        known = [*traces, *subject.searches.explored()]
        for trace in known:
            if not _succeeds_truncated(trace):
                continue
            longer = [
                other for other in known if other.rollout.seed == trace.rollout.seed and other.steps > trace.steps
            ]
            if longer:
                yield self.finding(
                    "EC507",
                    f"the success at step {trace.steps} is truncated, not terminated, but this is not a time limit: "
                    f"{longer[0].rollout.player} plays longer on the same seed",
                    line=subject.line_of("step"),
                    repro=repro(trace.rollout.cut(trace.steps)),
                    step=trace.steps,
                )
                return

    def _judge_cut(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        """Report losses whose only flag is truncated: they come at steps that play decides, and no loss terminates."""
        known = [*traces, *(trace for trace in subject.searches.explored() if trace.usable and trace.steps)]
        if any(trace.ended and trace.terminated[-1] and not trace.success for trace in known):
            return
        longest = max(known, key=lambda trace: trace.steps)
        cut = [trace for trace in known if trace.ended and not trace.terminated[-1] and not trace.reported_success]
        cut = [trace for trace in cut if trace.steps <= longest.steps * _SOON]
        kinds = [{trace.steps for trace in cut}, {_since_paid(trace) for trace in cut}]
        if min(map(len, kinds)) < _VARIED:
            return
        # Each level may have a limit of its own.
        if len({trace.rollout.seed for trace in cut}) == len({(trace.rollout.seed, trace.steps) for trace in cut}):
            return
        costly = all(trace.rewards[-1] < min(0.0, *trace.rewards[:-1]) for trace in cut)
        shortest = min(cut, key=lambda trace: trace.steps)
        finding = self.finding(
            "EC510",
            f"{len(cut)} episodes are truncated, and none is terminated without success, but this is no time limit: "
            f"they end after {shortest.steps} to {max(trace.steps for trace in cut)} steps, as play decides, "
            f"{'and their last steps cost most, ' if costly else ''}while {longest.rollout.player} goes on "
            f"to step {longest.steps}",
            line=_truncating_line(subject) or subject.line_of("step"),
            repro=repro(shortest.rollout.cut(shortest.steps)),
            episodes=len(cut),
            shortest=shortest.steps,
            longest=longest.steps,
        )
        yield finding if costly else finding.as_warning()

    def _is_mistaken(self, trace: Trace) -> bool:
        """Whether an episode terminates without success, where its limit should truncate it.

        If info reports no success, an end that pays more than any step before it is a goal, such as to survive so long.
        """
        if trace.reported_success is None and trace.rule.sign and trace.steps > 1:
            goal = trace.rewards[-1] > max(0.0, *trace.rewards[:-1])
        else:
            goal = bool(trace.reported_success)
        return trace.ended and not trace.truncated[-1] and not goal

    def _others(self, subject: Subject, trace: Trace) -> list[Trace]:
        """The same actions on two other seeds, or on one if the budget does not allow two."""
        numbers = [number for number in range(3) if subject.episode_seed(number) != trace.rollout.seed]
        numbers = numbers[: 2 if subject.affords(2 * trace.steps) else 1]
        seeds = map(subject.episode_seed, numbers)
        return subject.rollouts([msgspec.structs.replace(trace.rollout, seed=seed) for seed in seeds])

    def _judge_short(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        ended = [trace for trace in traces if trace.ended]
        if len(ended) < 6 or max(trace.steps for trace in traces) > _PLAYABLE:
            return
        # Not the rest of info: it may tell where the player is, who can do nothing there.
        outcomes: dict[int, set[tuple[float, int, bool | None]]] = {}
        for trace in ended:
            outcome = trace.total, trace.steps, trace.reported_success
            outcomes.setdefault(trace.rollout.seed, set()).add(outcome)
        decided = any(len(different) > 1 for different in outcomes.values())
        # A truncation this far from the contract's limit is a defect of any game.
        cut = subject.contract.limit is not None and any(trace.truncated[-1] for trace in ended)
        if decided and not cut:
            return
        longest = max(ended, key=lambda trace: trace.steps)
        why = "and a truncation ends some of them" if cut else "and no action changes the return or the end"
        yield self.finding(
            "EC503",
            f"all {len(ended)} episodes end within {plural(longest.steps, 'step')} under every policy, {why}",
            line=subject.line_of("step"),
            repro=repro(longest.rollout.cut(longest.steps)),
            episodes=len(ended),
        )

    def _judge_after(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        # An adapter's truncation says nothing about the game, so terminated episodes come first. The steps past the end
        # of doing nothing are known.
        idle = subject.episodes.idle
        ended = [trace for trace in traces if trace.ended]
        if not ended:
            return
        first = min(ended, key=lambda trace: (not trace.terminated[-1], trace is not idle, trace.steps))
        rollout = subject.episodes.past_end(first.rollout)
        trace = subject.rollout(rollout)
        alive = [
            step for step, (_, terminated, truncated) in enumerate(trace.after, 1) if not (terminated or truncated)
        ]
        if alive:
            yield self.finding(
                "EC505",
                f"{plural(alive[0], 'step')} after its end at step {trace.steps} the episode continues: both flags are "
                "false again",
                line=subject.line_of("step"),
                repro=repro(rollout),
            )
            return
        yield from self._judge_late(subject, [*traces, *subject.searches.explored()], trace)

    def _judge_late(self, subject: Subject, traces: list[Trace], ended: Trace) -> Iterator[Finding]:
        """Report an episode whose reward of the end is paid once, at the step after its end: one that is larger than
        all others, or the same one in several episodes.
        """
        late, *rest = [reward for reward, _, _ in ended.after] or [0.0]
        largest = max(abs(reward) for trace in traces for reward in trace.rewards)
        # A limit that truncates may come just before an end of the game's own.
        if not rest or not ended.terminated[-1]:
            return
        if abs(late) > max(largest, *(_TIMES * abs(reward) for reward in rest)):
            words = f"no step of {len(traces)} episodes pays or costs more than {largest:g}"
        elif shown := self._owed(subject, traces, ended):
            words = f"the same holds in all of {shown} episodes, and none of their last steps pays this reward"
        else:
            return
        yield self.finding(
            "EC508",
            f"the step after the end at step {ended.steps} pays {late:g}, and the next one {rest[0]:g}; {words}: the "
            "reward of the end comes a step late",
            line=subject.line_of("step"),
            repro=repro(ended.rollout),
            late=late,
            largest=largest,
        )

    def _owed(self, subject: Subject, traces: list[Trace], ended: Trace) -> int:
        """How many episodes pay the same once in the first call after their end, which their last steps do not pay and
        most steps do not either; 0 if some episode does not.
        """
        usual, _ = Counter(reward for trace in traces for reward in trace.rewards).most_common(1)[0]
        if ended.after[0][0] == usual or not _owes(ended):
            return 0
        # One of each seed first: different actions on one seed may end alike.
        known = sorted((each for each in traces if each.ended and each.terminated[-1]), key=lambda each: each.steps)
        known = [each for each in known if each.rollout.key() != ended.rollout.under(Conditions()).key()]
        first = list({each.rollout.seed: each for each in reversed(known)}.values())
        chosen = [*first, *(each for each in known if each not in first)][: _OWING - 1]
        seeds = {ended.rollout.seed, *(each.rollout.seed for each in chosen)}
        if len(chosen) < _OWING - 1 or len(seeds) < 2 or not subject.affords(sum(each.steps for each in chosen)):
            return 0
        again = subject.rollouts([subject.episodes.past_end(each.rollout) for each in chosen])
        return _OWING if all(_owes(each) and each.after[0][0] == ended.after[0][0] for each in again) else 0


def _owes(trace: Trace) -> bool:
    """Whether the first call after an episode pays what neither its last step nor the second call pays."""
    paid = [reward for reward, _, _ in trace.after]
    over = trace.usable and trace.ended and trace.terminated[-1]
    return over and len(paid) > 1 and paid[0] not in (trace.rewards[-1], paid[1])


def _over(trace: Trace) -> int:
    """The last step that pays another reward than all that follow, if it costs most of all and many follow; else 0."""
    if trace.opaque or trace.reported_success or trace.terminated[-1]:
        return 0
    last = next((step for step in range(trace.steps, 0, -1) if trace.rewards[step - 1] != trace.rewards[-1]), 0)
    costs = last > 0 and trace.rewards[last - 1] == min(trace.rewards) and trace.rewards[last - 1] < 0
    return last if costs and trace.steps - last >= _DEAD else 0


def _survives(trace: Trace, reward: float) -> bool:
    """Whether an episode shows something new after a step that costs as much."""
    if not trace.usable or trace.opaque:
        return False
    first = next((step for step, paid in enumerate(trace.rewards, 1) if paid <= reward), trace.steps)
    later = trace.rewards[first + 1 :]
    return len(set(later)) > 1


def _otherwise(subject: Subject, trace: Trace, step: int, last: int) -> Rollout:
    """The same episode up to one step after `step`, and then other actions."""
    from envcraft.judging.actions import sticky_actions

    seed = trace.rollout.seed
    others = sticky_actions(subject.action_space, seed + 1, last - step - 1)
    return Rollout(seed, trace.actions[: step + 1] + others, player=f"other actions after step {step + 1}")


def _alike(one: Trace, two: Trace, first: int, last: int) -> bool:
    """Whether two episodes show and pay the same between two steps."""
    if not two.usable or two.opaque or two.steps < last or two.terminated[last - 1]:
        return False
    return (
        one.observations[first : last + 1] == two.observations[first : last + 1]
        and one.rewards[first:last] == two.rewards[first:last]
    )


def _since_paid(trace: Trace) -> int:
    """The steps from the last unusual reward to the last step, whose own reward may be that of the end."""
    usual, _ = Counter(trace.rewards).most_common(1)[0]
    rewards = trace.rewards[-2::-1]
    return next((steps for steps, reward in enumerate(rewards, 1) if reward != usual), trace.steps)


def _truncating_line(subject: Subject) -> int | None:
    """The one line of step() that decides `truncated`; None where several may."""
    program = program_of(subject)
    step = program.method(program.env, "step") if program is not None else None
    if step is None:
        return None
    returned = [node.value for node in step.nodes if isinstance(node, ast.Return)]
    flags = [value.elts[-2] for value in returned if isinstance(value, ast.Tuple) and len(value.elts) == _RESULTS]
    names = {node.id for flag in flags for node in ast.walk(flag) if isinstance(node, ast.Name)}
    named = {name for name in names if "trunc" in name} or names
    lines = {
        line(statement)
        for target, value, statement in step.bindings
        if isinstance(target, ast.Name) and target.id in named and not isinstance(value, ast.Constant)
    }
    return lines.pop() if len(lines) == 1 else None


def _success(trace: Trace) -> int:
    """The first step whose info reports success; 0 if none does."""
    key = trace.rule.key
    return next((step for step in range(1, trace.steps + 1) if trace.info(step).get(key)), 0)


def _succeeds_truncated(trace: Trace) -> bool:
    """Whether an episode is only truncated at the first step at which info reports success."""
    cut = trace.ended and trace.truncated[-1] and not trace.terminated[-1]
    return cut and bool(trace.reported_success) and trace.steps > 1 and _success(trace) == trace.steps


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Termination()]
