"""# difficulty

## What it does
Checks that the game can be won, and that winning takes decisions.

With `--policy FILE` a privileged policy plays in the worker: a class with `act(state)`, which reads the environment's
attributes from the state, or a function `policy(env)`. The check then steps the policy's actions without the policy. If
the traces differ, the policy changed the environment, unless the environment differs by itself. A policy that changes
the environment, raises or chooses no valid action does not fail the environment: `envcraft validate` names the policy's
line and exits with status 2. Such faults are findings only if a program wrote the policy. A policy that never wins must
be clearly better than random play and doing nothing: the 95% interval of its lead over each, on the same seeds, must
lie above zero.

Without a policy, or if it does not win, a built-in player searches on copies of the environment's state, or replays
actions if the state cannot be copied. The check then plays the actions that the search returns.

A game is unsolvable only if a search visited all reachable states without a positive outcome, and no whole episode
reaches another state, since a hidden timer might open a door. A game is trivial if one held action, or the first moves
of a greedy player, win on nearly every seed. This is a warning if wins are known only by the sign of a return that
mostly pays for each step, and for the greedy player also if every episode ends within 20 steps: it tries its moves on
copies of the state, so it knows what an agent must remember or infer. If many held actions win the first episode, the
check judges the five that win fastest. If the budget settles neither question, the check is skipped with the reason.

If the game can be won and has few states, the search also looks for a success on further seeds. A seed cannot be won if
none of its reachable states is a success. Two such seeds are an error, and one is a warning.

If the code reads the clock and uses the time in the game, the speed of the machine decides how often play wins. The
check is then skipped instead of a finding about wins. The same holds if a generator with a fixed seed, which reset()
does not seed again, makes all fresh episodes draw the same numbers.

If no proof is possible, but the exploration met no new state in its second half, a game without a positive outcome gets
a warning. Another warning names lines of `step()` that pay, win or end the episode, and that no play and no search
reached; the worker reports which lines ran. The check gives this warning if the exploration met no new state in its
second half, and at `standard` also if the game was won. Penalties, guards and exception handlers do not count. Lines
that depend on a count of steps, an option of the constructor or `render_mode` do not count either. If the check is
skipped without a warning, the reason names these lines.

In a game of cells, play shows which attribute is the player's cell, what the player gathers, and which values of the
grid are walls. A seed on which walls enclose a thing that success needs cannot be won. Two or more such seeds of a
hundred are an error, and one is a warning. If more than 60% of the seeds have an enclosed thing, the check does not
report them, because there may be a way that play did not find.

A warning says that info reports success under a key that the contract does not read, such as `won`. The sign of the
return then decides whether an episode is won, or wins are unknown.

## Why is this bad?
A game that no agent can win, or that every agent wins, says nothing about an agent.

## Example
```python
self.keys_needed = 3      # EC801: the level has two keys
```
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.errors import Skip, Undecided
from envcraft.judging import policy
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.judging.statistics import Exact, Proportion, lead, settle
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl
from envcraft.text import plural

from .instawin import BY_SIGN, counts_survival
from .linting.clock import timed
from .linting.gathered import needs_all, only_walks
from .linting.generators import drawn_alike
from .linting.logic import names_success
from .linting.program import line, program_of

if TYPE_CHECKING:
    from envcraft.judging.coverage import Range
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace
    from envcraft.model.verdict import Line

#: Codes that depend on how often play wins.
_BY_WINS = frozenset({"EC801", "EC802", "EC803", "EC807", "EC808"})
_GREEDY_MOVES = 5
#: How many times as long as the greedy moves an episode is at least in which they mean that the game is easy.
_FEW = 4
#: The most held actions that are judged: more would err more often in all than one test may.
HELD = 5
#: The share of the episodes of a test that are won before the last ones may exceed the budget.
_NEARLY = 0.75
#: The most ranges of lines that a message names.
_RANGES = 4
#: Episodes without a win after which a policy is compared with random play.
_COMPARED = 6


class Difficulty(Check):
    name = "difficulty"
    rules = (
        Rule("EC801", "unsolvable", "No positive outcome can be reached.", "Make the goal reachable, and reward it."),
        Rule("EC802", "fixed-action-wins", "One held action wins nearly always.", "Make winning require decisions."),
        Rule(
            "EC803", "first-choice-wins", "The first greedy moves win nearly always.", "Make the goal harder to reach."
        ),
        *policy.RULES,
        Rule(
            "EC806",
            "policy-no-better",
            "The privileged policy is not clearly better than random play or doing nothing.",
            "Fix the policy; the built-in player judges the environment.",
            Severity.WARNING,
        ),
        Rule(
            "EC807",
            "unsolvable-seeds",
            "On some seeds no positive outcome can be reached.",
            "Search for a way to the goal in reset(), and draw again if there is none.",
            confirmed_by=("EC503",),
        ),
        Rule(
            "EC808",
            "no-success-seen",
            "No episode and no search has a positive outcome.",
            "Check that the goal can be reached; a privileged policy that wins settles it.",
            Severity.WARNING,
            # The search repeats episodes, which gives others there.
            confirmed_by=("EC201", "EC202", "EC205"),
        ),
        Rule(
            "EC809",
            "never-reached",
            "Lines that pay, win or end the episode were never reached.",
            "Check the conditions before these lines; a privileged policy that reaches them settles it.",
            Severity.WARNING,
        ),
        Rule(
            "EC810",
            "success-unread",
            "info reports success under a key that the contract does not read.",
            'Report is_success, or name the key in a contract of your own, such as `success = "won"`.',
            Severity.WARNING,
        ),
        Rule(
            "EC811",
            "enclosed-things",
            "On some seeds walls enclose a thing that the player must gather.",
            "Search for a way to each thing in reset(), and place it again if there is none.",
            confirmed_by=("EC503", "EC807"),
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        yield from self._judge_key(subject)
        skipped: Skip | None = None
        try:
            for finding in self._judge_play(subject):
                if finding.code in _BY_WINS:
                    timed(subject)
                    drawn_alike(subject)
                yield finding
        except Skip as skip:
            skipped = skip
        if subject.out_of_time or not all(trace.usable and trace.steps for trace in subject.episodes.whole):
            missed = []
        else:
            missed = subject.coverage.missed()
        if missed and (subject.searches.saturated or (skipped is None and subject.budget.rotations)):
            yield self.finding(
                "EC809",
                f"{_listed(missed)} never reached in {subject.steps:,} steps",
                line=missed[0].first,
                lines=[[each.first, each.last] for each in missed],
                steps=subject.steps,
            )
        elif missed and skipped is not None:
            raise type(skipped)(f"{skipped}; {_listed(missed)} never reached")
        if skipped is not None:
            raise skipped

    def _judge_key(self, subject: Subject) -> Iterator[Finding]:
        """Report a key for success that every episode ends with, and that is not the contract's."""
        traces = [trace for trace in subject.played() if trace.usable and trace.steps]
        if not traces or any(trace.reported_success is not None for trace in traces):
            return
        infos = [trace.info() for trace in traces]
        names = [name for name in infos[0] if names_success(name)]
        unread = [name for name in names if all(isinstance(info.get(name), bool) for info in infos)]
        if unread:
            contract, name = subject.contract, unread[0]
            otherwise = (
                "a positive return at the end counts as a win" if contract.success.sign else "wins are not known"
            )
            yield self.finding(
                "EC810",
                f"info reports {name!r}, and the contract {contract.name} reads {contract.success.key!r}; without "
                f"that, {otherwise}",
                line=_line_of_key(subject, name),
                key=name,
            )

    def _judge_play(self, subject: Subject) -> Iterator[Finding]:
        if not any(trace.usable and trace.steps for trace in subject.played()):
            raise Undecided("each episode raises an error or has no step")
        success = subject.contract.success
        if not success.sign and all(trace.reported_success is None for trace in subject.played()):
            raise Skip(f"info has no {success.key}, so wins are not known")
        policy_wins = False
        if subject.policy is not None:
            wrong = self._judge_policy(subject)
            if wrong is not None:
                yield wrong
            else:
                rate = self._policy_rate(subject)
                policy_wins = rate.hits > 0
                # A crash of the environment takes from the policy what it would have earned.
                whole = all(subject.act(number).usable for number in range(rate.n))
                if not policy_wins and rate.n >= _COMPARED and whole:
                    yield from self._compare(subject, rate)
        unsettled = "" if policy_wins else self._unsolved(subject)
        if unsettled == _UNSOLVABLE:
            yield self._unsolvable(subject)
            return
        trivial, open_question = self._judge_held(subject)
        trivial = trivial or self._judge_greedy(subject)
        if trivial is None and not unsettled:
            trivial = self._unsolvable_seeds(subject)
            unsettled = open_question
        if trivial is not None:
            yield trivial
        elif (found := self._enclosed(subject)) is not None:
            yield found
        elif unsettled:
            crashed = any(outcome.get("crash") for outcome in subject.searches.explorations)
            if subject.searches.saturated and not crashed:
                yield self._unseen(subject)
            raise Undecided(unsettled)

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code in ("EC804", "EC805"):
            return self._judge_policy(subject)
        return super().confirm(subject, finding)

    def _policy_rate(self, subject: Subject) -> Proportion:
        """How often the policy wins, in more episodes if it does not win the first ones."""
        enough, most = subject.budget.looks[:2]
        wins = longest = played = 0
        while played < (enough if wins else most):
            # Each episode is compared with random play and with doing nothing if none is won.
            if played and not subject.affords(longest if wins else 3 * longest * (played + 1)):
                break
            trace = subject.act(played)
            played += 1
            wins += trace.positive
            longest = max(longest, trace.steps)
        return Proportion(wins, played)

    def _judge_policy(self, subject: Subject) -> Finding | None:
        for trace in subject.rollouts([subject.probes.policy(number) for number in range(subject.budget.policy)]):
            wrong = policy.judge_play(self, subject, trace)
            wrong = wrong or policy.judge_effect(self, subject, trace, subject.without_policy(trace))
            if wrong is not None:
                return wrong
        return None

    def _compare(self, subject: Subject, rate: Proportion) -> Iterator[Finding]:
        """Compare a policy that never wins with random play and doing nothing, by their returns on the same seeds."""
        numbers = range(rate.n)
        ask = {"the policy": subject.probes.policy, "random play": subject.probes.random}
        if subject.contract.noop is not None:
            ask["doing nothing"] = subject.probes.noop
        played = {name: subject.rollouts([play(number) for number in numbers]) for name, play in ask.items()}
        returns = {name: [trace.total for trace in traces] for name, traces in played.items()}
        leads = {name: lead(returns["the policy"], others) for name, others in returns.items() if name != "the policy"}
        short = {name: found for name, found in leads.items() if found.low <= 0}
        if short:
            words = " and ".join(
                f"its lead over {name} is {found.mean:.3g} (95% interval {found.low:.3g} to {found.high:.3g})"
                for name, found in short.items()
            )
            yield self.finding(
                "EC806",
                f"the policy wins {rate}, and its mean return on these seeds is not clearly higher: {words}",
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
        """Why it is not settled whether the game can be won: empty if it can, _UNSOLVABLE if it cannot."""
        won = any(trace.positive for trace in subject.traces)
        if won or any(trace.positive for trace in subject.searches.explored()):
            return ""
        if any(outcome.get("crash") for outcome in subject.searches.explorations):
            return "the exploration ends early at a defect of step(), so the reachable states are not known"
        why = "" if subject.searches.exhaustible else "more remain"
        for number in [] if why else subject.searches.proven:
            outcome = subject.searches.exhaust(number)
            win = outcome.get("win")
            if win and subject.searches.scripted(number, win, "search through all states").positive:
                return ""
            if not outcome.get("exhausted"):
                why = "the game draws random numbers in step()" if outcome.get("stochastic") else "more remain"
                break
        if why:
            explored = sum(int(outcome.get("states") or 0) for outcome in subject.searches.explorations)
            return (
                f"no positive outcome in {len(subject.traces)} episodes and {explored:,} explored states, "
                f"but the search did not reach all states ({why}): {_settled_by(subject)} may settle it"
            )
        return _UNSOLVABLE

    def _unseen(self, subject: Subject) -> Finding:
        """The finding that no play was seen to succeed."""
        usable = [trace for trace in subject.traces if trace.usable and trace.steps]
        best = max(usable, key=lambda trace: trace.total)
        states = sum(int(outcome.get("states") or 0) for outcome in subject.searches.explorations)
        reported = any(trace.reported_success is not None for trace in usable)
        key = subject.contract.success.key
        return self.finding(
            "EC808",
            f"{f'{key} was never true' if reported else 'no episode ended with a positive return'} in "
            f"{len(subject.traces)} episodes of {subject.steps:,} steps, and the exploration met no new state in its "
            f"second half ({states:,} states, highest return {best.total:g})",
            line=subject.line_of("step"),
            repro=repro(best.rollout.cut(best.steps)),
            steps=subject.steps,
            states=states,
        )

    def _unsolvable(self, subject: Subject) -> Finding:
        seeds = len(subject.searches.proven)
        states = sum(int(subject.searches.exhaust(number).get("states") or 0) for number in range(seeds))
        best = max((trace for trace in subject.traces if trace.usable), key=lambda trace: trace.total)
        return self.finding(
            "EC801",
            f"no positive outcome in all {states} reachable states of {'one seed' if seeds == 1 else f'{seeds} seeds'} "
            f"and {len(subject.traces)} episodes (highest return {best.total:g})",
            line=subject.line_of("step"),
            repro=repro(best.rollout.cut(best.steps)),
            states=states,
            seeds=seeds,
            rate=Proportion(0, len(subject.traces)).evidence(),
        )

    def _unsolvable_seeds(self, subject: Subject) -> Finding | None:
        """The finding that some seeds cannot be won, proven on each; a warning if it is only one of the seeds.

        Only a success that is reported tells which end is a win.
        """
        if all(trace.reported_success is None for trace in subject.played()):
            return None
        numbers, states, settled = subject.searches.unwinnable()
        words = f"none of the {states} reachable states is a success"
        return self._on_seeds(subject, "EC807", numbers, settled, words, states=states)

    def _enclosed(self, subject: Subject) -> Finding | None:
        """The finding that walls enclose, on some seeds, a thing that the player must gather."""
        program = program_of(subject)
        if program is None:
            return None
        outcome = subject.searches.enclosed()
        numbers, looked = outcome.get("enclosed") or [], outcome.get("looked") or 0
        # Where most seeds have such a thing, there may be a way that random play does not take.
        if len(numbers) > _MOST_ENCLOSED * looked:
            return None
        player, place, board = (outcome.get("player") or "", outcome.get("place") or "", outcome.get("board") or "")
        needed = needs_all(program, place, outcome.get("placed") or 0)
        if not needed or not only_walks(program, set(player.split(", ")), board, place):
            return None
        words = f"walls enclose a cell of self.{place} that the player must come to"
        return self._on_seeds(subject, "EC811", numbers, looked, words)

    def _on_seeds(
        self, subject: Subject, code: str, numbers: list[int], judged: int, words: str, **evidence: Any
    ) -> Finding | None:
        """The finding that some of the judged seeds cannot be won; a warning if it is only one of them.

        There is none if some play has won on one of the seeds after all.
        """
        seeds = [subject.episode_seed(number) for number in numbers]
        won = {trace.rollout.seed for trace in [*subject.traces, *subject.searches.explored()] if trace.positive}
        if not seeds or not won.isdisjoint(seeds):
            return None
        shown = subject.random(numbers[0])
        if not shown.usable or shown.positive:
            return None
        rate = Exact(len(seeds), judged)
        finding = self.finding(
            code,
            f"on {rate} seeds {words} (seeds {', '.join(map(str, seeds[:_RANGES]))}{', …' if seeds[_RANGES:] else ''})",
            line=subject.line_of("reset"),
            repro=repro(shown.rollout.cut(shown.steps)),
            rate=rate.evidence(),
            seeds=seeds,
            **evidence,
        )
        return finding if seeds[1:] else finding.as_warning()

    def _judge_held(self, subject: Subject) -> tuple[Finding | None, str]:
        """Return the finding, or why it is unsettled whether there is one."""
        unsettled = ""
        for trace in _winning(subject.held())[:HELD]:
            action = trace.rollout.actions[0]
            wins: list[int] = []

            def won(number: int, action: Any = action, wins: list[int] = wins) -> bool:
                success = bool(subject.rollout(subject.probes.hold(action, number)).success)
                wins.extend([number] * success)
                return success

            def prefetch(numbers: range, action: Any = action) -> None:
                subject.prefetch(subject.probes.hold(action, number) for number in numbers)

            def affords(steps: int = trace.steps, wins: list[int] = wins) -> bool:
                # A few more episodes than the budget has settle what has won each time: a single loss ends this.
                return subject.affords(steps) or len(wins) >= _NEARLY * subject.episodes.looks[-1]

            verdict, rate = settle(won, subject.contract.consistently, subject.episodes.looks, prefetch, affords)
            if verdict is True and not self._beaten(subject, trace):
                found = self.finding(
                    "EC802",
                    f"holding {action} wins {rate}, more than {100 * subject.contract.consistently:g}%"
                    f"{BY_SIGN if trace.reported_success is None else ''}",
                    line=subject.line_of("step"),
                    repro=repro(trace.rollout.cut(trace.steps)),
                    rate=rate.evidence(),
                )
                return found.as_warning() if trace.reported_success is None and counts_survival(trace) else found, ""
            if (
                verdict is None
                and 1 < rate.hits == rate.n < subject.episodes.looks[-1]
                and trace.reported_success is not None
            ):
                unsettled = unsettled or (
                    f"holding {action} wins all of {plural(rate.n, 'episode')}, and the budget {subject.budget.name} "
                    "allows too few episodes to settle whether it wins more than "
                    f"{100 * subject.contract.consistently:g}%"
                )
        return None, unsettled

    def _beaten(self, subject: Subject, trace: Trace) -> bool:
        """Whether other play clearly earns more, if only the sign of the return defines a win."""
        if trace.reported_success is not None:
            return False
        best = max(other.total for other in [*subject.played(), *subject.searches.explored(), *subject.privileged()])
        return best > 1.25 * trace.total

    def _judge_greedy(self, subject: Subject) -> Finding | None:
        def won(number: int) -> bool:
            chosen = subject.searches.greedy(number).get("best") or []
            if not chosen:
                return False
            trace = subject.searches.scripted(number, chosen, "the greedy player")
            # Where success means that nothing has failed yet, it is reported from the reset on, and proves nothing.
            return bool(trace.success) and (trace.ended or not trace.info(0).get(trace.rule.key))

        verdict, rate = settle(
            won,
            subject.contract.consistently,
            subject.episodes.looks,
            lambda numbers: subject.prefetch(map(subject.searches.greed, numbers)),
            lambda: subject.affords(_GREEDY_MOVES * len(subject.joint_actions)),
        )
        if verdict is not True:
            return None
        first = next(number for number in range(rate.n) if won(number))
        trace = subject.searches.scripted(first, subject.searches.greedy(first).get("best") or [], "the greedy player")
        found = self.finding(
            "EC803",
            f"the actions with the best immediate reward win {rate} within {_GREEDY_MOVES} steps, more than "
            f"{100 * subject.contract.consistently:g}%",
            line=subject.line_of("step"),
            repro=repro(msgspec.structs.replace(trace.rollout, actions=trace.actions)),
            rate=rate.evidence(),
        )
        return found.as_warning() if _short(subject) else found


_UNSOLVABLE = "unsolvable"
#: The largest share of seeds with an enclosed thing that counts as a defect.
_MOST_ENCLOSED = 0.6


def _line_of_key(subject: Subject, key: str) -> int | Line | None:
    """The first line of the code that names a key, or the line of step()."""
    program = program_of(subject)
    named = (node for node in program.nodes if isinstance(node, ast.Constant) and node.value == key) if program else ()
    first = min(map(line, named), default=0)
    return first or subject.line_of("step")


def _short(subject: Subject) -> bool:
    """Whether all play ends so early that a win within the greedy moves is no sign of an easy game.

    A game of few decisions may ask for what the agent must remember or infer, which the greedy player sees at once.
    """
    return all(trace.ended and trace.steps < _FEW * _GREEDY_MOVES for trace in subject.played() if trace.usable)


def _settled_by(subject: Subject) -> str:
    """What the author can still do to show that the game can be won."""
    policy = "a --policy" if subject.policy is None else "a --policy that wins (the given one does not)"
    return policy if subject.budget.name == list(BUDGETS)[-1] else f"a larger --budget or {policy}"


def _winning(held: list[Trace]) -> list[Trace]:
    """The episodes that win, the shortest first, which settle the question for fewer steps; of equal ones, the first.

    Actions that differ in a button without effect play the same episode.
    """
    different: dict[tuple[Any, ...], Trace] = {}
    for trace in held:
        if trace.success:
            alone = str(trace.rollout.actions[0]) if trace.opaque else ""
            different.setdefault((*trace.observations, *trace.rewards, alone), trace)
    return sorted(different.values(), key=lambda trace: trace.steps)


def _listed(missed: list[Range]) -> str:
    """The lines, what they do, and the verb for them."""
    shown = [str(each) for each in missed[:_RANGES]]
    if len(missed) > _RANGES:
        shown.append(f"{len(missed) - _RANGES} more")
    single = len(missed) == 1 and missed[0].first == missed[0].last
    return f"{', and '.join([', '.join(shown[:-1]), shown[-1]] if shown[1:] else shown)}, {'was' if single else 'were'}"


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Difficulty()]
