"""# difficulty

## What it does
Asks whether the game can be won, and whether it takes anything to win it.

With `--policy FILE` a privileged policy plays in the worker: a class with `act(state)`, whose state gives the
environment's attributes to read, or a function `policy(env)`. Its actions are then stepped again without it: where
the trace differs, the policy changed the environment. Without a policy, or where it does not win, a built-in player
searches on copies of the environment's state, or by replaying actions where it cannot be copied. What it finds is
stepped for real. A policy that never wins is not clearly better than random play or doing nothing unless the 95%
interval of its lead over either, on the same seeds, lies above zero.

Unsolvable is only said of a game whose reachable states were searched through to the last without a positive
outcome, and whose whole episodes lead to no other state: a hidden timer may yet open a door. Trivial is a game that
one held action, or the best-looking first moves, win on nearly every seed. Where the budget settles neither the check
is skipped, with the reason.

## Why is this bad?
A game that cannot be won, or that any agent wins, tells nothing about an agent.

## Example
```python
self.keys_needed = 3      # EC801: the level has two keys
```
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.check import Check, Rule, Skip
from envcraft.plugins import hookimpl
from envcraft.shrink import repro
from envcraft.stats import Proportion, lead, settle
from envcraft.verdict import Finding, Repro, Severity

from .instawin import BY_SIGN

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace

_GREEDY_MOVES = 5


class Difficulty(Check):
    name = "difficulty"
    rules = (
        Rule("EC801", "unsolvable", "No positive outcome can be reached.", "Make the goal reachable, and pay for it."),
        Rule("EC802", "fixed-action-wins", "One action, held, wins nearly always.", "Make winning take a decision."),
        Rule("EC803", "first-choice-wins", "The first greedy moves win nearly always.", "Put the goal further away."),
        Rule(
            "EC804",
            "policy-writes",
            "The privileged policy changes the environment.",
            "Read the state, change nothing.",
        ),
        Rule("EC805", "policy-fails", "The privileged policy raises or chooses no valid action.", "Mend the policy."),
        Rule(
            "EC806",
            "policy-no-better",
            "The privileged policy is not clearly better than random play or doing nothing.",
            "Mend the policy; the environment is judged by the built-in player.",
            Severity.WARNING,
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if not any(trace.usable and trace.steps for trace in subject.played()):
            raise Skip("no episode could be stepped")
        success = subject.contract.success
        if not success.sign and all(trace.told is None for trace in subject.played()):
            raise Skip(f"info has no {success.key}, and without it nothing tells what winning is")
        policy_wins = False
        if subject.policy is not None:
            wrong = self._judge_policy(subject)
            if wrong is not None:
                yield wrong
            else:
                _, rate = settle(
                    lambda number: subject.act(number).positive,
                    0.0,
                    subject.budget.looks[:2],
                    lambda numbers: subject.foresee(map(subject.players.policy, numbers)),
                )
                policy_wins = rate.hits > 0
                if not policy_wins:
                    yield from self._compare(subject, rate)
        unsettled = "" if policy_wins else self._unsolved(subject)
        if unsettled == _UNSOLVABLE:
            yield self._unsolvable(subject)
            return
        trivial = self._judge_held(subject) or self._judge_greedy(subject)
        if trivial is not None:
            yield trivial
        elif unsettled:
            raise Skip(unsettled)

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code in ("EC804", "EC805"):
            return self._judge_policy(subject)
        return super().confirm(subject, finding)

    def _judge_policy(self, subject: Subject) -> Finding | None:
        for trace in subject.rollouts([subject.players.policy(number) for number in range(3)]):
            if trace.refused:
                return self.finding("EC805", f"the policy's move {len(trace.chosen)} is refused: {trace.refused}")
            if trace.fault is not None and (
                trace.fault.phase == "policy write" or trace.fault.type.endswith("ReadOnlyState")
            ):
                words = f"the policy writes to the environment at step {trace.steps + 1}: {trace.fault.message}"
                shown = Repro(trace.rollout.seed, trace.actions)
                return self.finding("EC804", words, line=trace.fault.line, repro=shown, step=trace.steps + 1)
            if trace.fault is not None and trace.fault.phase == "policy":
                words = f"the policy raises {trace.fault} at step {trace.steps + 1}"
                shown = Repro(trace.rollout.seed, trace.actions)
                return self.finding("EC805", words, line=trace.fault.line, repro=shown, traceback=trace.fault.traceback)
            if trace.choosing and trace.end is not None:
                words = f"the policy does not choose move {trace.steps + 1} ({trace.end.how}: {trace.end.detail})"
                return self.finding("EC805", words, repro=Repro(trace.rollout.seed, trace.actions), **trace.printed)
            plain = subject.without_policy(trace)
            if (found := _diverge(trace, plain)) is not None:
                return self.finding(
                    "EC804",
                    f"without the policy its actions give another trace: {found}",
                    repro=repro(plain.rollout.cut(found.step)),
                    step=found.step,
                    field=found.field,
                )
        return None

    def _compare(self, subject: Subject, rate: Proportion) -> Iterator[Finding]:
        """Hold a policy that never wins against random play and doing nothing, by returns on the same seeds."""
        numbers = range(rate.n)
        ask = {"the policy": subject.players.policy, "random play": subject.players.random}
        if subject.contract.noop is not None:
            ask["doing nothing"] = subject.players.noop
        played = {name: subject.rollouts([play(number) for number in numbers]) for name, play in ask.items()}
        returns = {name: [trace.total for trace in traces] for name, traces in played.items()}
        leads = {name: lead(returns["the policy"], others) for name, others in returns.items() if name != "the policy"}
        short = {name: found for name, found in leads.items() if found.low <= 0}
        if short:
            words = " and ".join(
                f"over {name} {found.mean:.3g} (95% interval {found.low:.3g} to {found.high:.3g})"
                for name, found in short.items()
            )
            yield self.finding(
                "EC806",
                f"the policy wins {rate}, and on those seeds its mean return has no lead that is clearly above zero: "
                f"{words}",
                repro=repro(
                    msgspec.structs.replace(subject.act(0).rollout, actions=subject.act(0).actions, policy=False)
                ),
                rate=rate.evidence(),
                means={name: sum(totals) / rate.n for name, totals in returns.items()},
                leads={
                    name: {"estimate": found.mean, "low": found.low, "high": found.high, "n": rate.n}
                    for name, found in leads.items()
                },
            )

    def _unsolved(self, subject: Subject) -> str:
        """Nothing when some seed has a positive outcome; _UNSOLVABLE; or why neither is settled."""
        won = any(trace.positive for trace in subject.traces)
        if won or any(trace.positive for trace in subject.searches.explored()):
            return ""
        if any(subject.searches.explore(number).get("crash") for number in range(subject.budget.explore[1])):
            return "exploration ends in a crash, so what can be reached is not known"
        for number in range(subject.budget.explore[1]):
            told = subject.searches.exhaust(number)
            win = told.get("win")
            if win and subject.searches.scripted(number, win, "search through all states").positive:
                return ""
            if not told.get("exhausted"):
                why = "the game draws random numbers while it is stepped" if told.get("stochastic") else "more remain"
                explored = sum(
                    int(subject.searches.explore(seed).get("states") or 0) for seed in range(subject.budget.explore[1])
                )
                return (
                    f"no positive outcome in {len(subject.traces)} episodes and {explored:,} explored states, "
                    f"but not all states were reached ({why}): a larger --budget or a --policy may settle it"
                )
        return _UNSOLVABLE

    def _unsolvable(self, subject: Subject) -> Finding:
        seeds = subject.budget.explore[1]
        states = sum(int(subject.searches.exhaust(number).get("states") or 0) for number in range(seeds))
        best = max((trace for trace in subject.traces if trace.usable), key=lambda trace: trace.total)
        return self.finding(
            "EC801",
            f"all {states} reachable states of {'one seed' if seeds == 1 else f'{seeds} seeds'} were searched and "
            f"{len(subject.traces)} episodes played: "
            f"no positive outcome (highest return {best.total:g})",
            line=subject.line_of("step"),
            repro=repro(best.rollout.cut(best.steps)),
            states=states,
            seeds=seeds,
            rate=Proportion(0, len(subject.traces)).evidence(),
        )

    def _judge_held(self, subject: Subject) -> Finding | None:
        for trace in subject.held():
            if not trace.success:
                continue
            action = trace.rollout.actions[0]

            def won(number: int, action: Any = action) -> bool:
                return bool(subject.rollout(subject.players.hold(action, number)).success)

            def foresee(numbers: range, action: Any = action) -> None:
                subject.foresee(subject.players.hold(action, number) for number in numbers)

            verdict, rate = settle(won, subject.contract.consistently, subject.budget.looks, foresee)
            if verdict is True and not self._beaten(subject, trace):
                return self.finding(
                    "EC802",
                    f"holding {action} wins {rate}, more than {100 * subject.contract.consistently:g}%"
                    f"{BY_SIGN if trace.told is None else ''}",
                    line=subject.line_of("step"),
                    repro=repro(trace.rollout.cut(trace.steps)),
                    rate=rate.evidence(),
                )
        return None

    def _beaten(self, subject: Subject, trace: Trace) -> bool:
        """Whether other play clearly earns more, where a positive return is all that winning means."""
        if trace.told is not None:
            return False
        best = max(other.total for other in [*subject.played(), *subject.searches.explored(), *subject.privileged()])
        return best > 1.25 * trace.total

    def _judge_greedy(self, subject: Subject) -> Finding | None:
        def won(number: int) -> bool:
            chosen = subject.searches.greedy(number).get("best") or []
            return bool(chosen) and bool(subject.searches.scripted(number, chosen, "the greedy player").success)

        verdict, rate = settle(
            won,
            subject.contract.consistently,
            subject.budget.looks,
            lambda numbers: subject.foresee(map(subject.searches.greed, numbers)),
        )
        if verdict is not True:
            return None
        first = next(number for number in range(rate.n) if won(number))
        trace = subject.searches.scripted(first, subject.searches.greedy(first).get("best") or [], "the greedy player")
        return self.finding(
            "EC803",
            f"the moves with the best immediate reward win {rate} within {_GREEDY_MOVES} steps, more than "
            f"{100 * subject.contract.consistently:g}%",
            line=subject.line_of("step"),
            repro=repro(msgspec.structs.replace(trace.rollout, actions=trace.actions)),
            rate=rate.evidence(),
        )


_UNSOLVABLE = "unsolvable"


def _diverge(first: Trace, second: Trace) -> Any:
    from envcraft.trace import diverge

    # What an info tells of the clock differs from run to run.
    return diverge(first, second, info=False)


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Difficulty()]
