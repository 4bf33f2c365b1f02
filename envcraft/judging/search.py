"""Searches in the worker. Their outcomes are advice: a rollout must confirm each."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Sequence
from functools import cached_property

from envcraft.judging.budget import Budget
from envcraft.judging.episodes import Episodes
from envcraft.judging.probes import Probes
from envcraft.judging.rollout_cache import RolloutCache
from envcraft.model.job import SearchOutcome
from envcraft.model.rollout import Action, Rollout, Search
from envcraft.model.trace import Trace

#: Steps that a rolling-horizon search may try for each step of the episode.
_HORIZON = 40
#: The most steps of a search for hidden states after its path.
_REACT = 360
#: The most steps of a search that goes back and forth after its path, how many such searches there are, and the steps
#: within which their episodes must be paid.
_ROCK, _ROCKS, _SOON = 250, 6, 60
#: Steps of random play that show what the cells of a game mean.
_CELLS = 1_200
#: Steps of a search for an episode that outlasts its limit, for each step of that limit.
_OUTLAST = 8
#: Steps of a greedy search, which makes five moves.
_GREEDY = 10_000
#: The share of the budget that an exploration leaves to the checks after it, and that a sweep leaves.
_LATER, _LAST = 0.3, 0.2
#: Steps of the episodes that explorations find, as a share of the budget.
_PATH = 0.01
#: The longest such episode at least.
_SHORT_PATH = 80
#: The fewest steps after an event that are worth an episode.
_ONWARD = 30
#: The fewest seeds of a proof: one of them may be a bad level.
_PROVEN = 2
#: Seeds that are searched for one that cannot be won, for each episode of random play; twice as many once one is found.
_SEEDS = 3
#: The share of the steps of a search through all states that the search for such a seed gets.
_PART = 4


class Searches:
    """The searches of one subject, each run once, as far as the budget allows. A `number` selects an episode seed."""

    def __init__(self, cache: RolloutCache, probes: Probes, episodes: Episodes, budget: Budget) -> None:
        self._cache = cache
        self._probes = probes
        self._episodes = episodes
        self._budget = budget

    def explore(self, number: int = 0) -> SearchOutcome:
        """Search for crashes and wins (see the worker's ``explore``)."""
        if number < len(self.explorations):
            return self.explorations[number]
        return self._cache.search(Search("explore", self._probes.episode_seed(number), self._explore_steps))

    @cached_property
    def _explore_steps(self) -> int:
        least, most, seeds = self._budget.explore
        # All shared episodes come first, so that the steps that are left do not depend on which check is first.
        _ = self._episodes.all, self._episodes.rotations
        left = self._episodes.steps_left - self._episodes.reserve - int(_LATER * self._budget.steps)
        left -= self._budget.onward[0]
        return max(min(left // seeds, most), least)

    @cached_property
    def explorations(self) -> list[SearchOutcome]:
        """The outcome of an exploration for each seed that the budget allows."""
        numbers = range(self._budget.explore[2])
        searches = [Search("explore", self._probes.episode_seed(number), self._explore_steps) for number in numbers]
        self._cache.prefetch(searches)
        return [self._cache.search(search) for search in searches]

    def explored(self) -> list[Trace]:
        """Traces of the shortest wins and the best episodes of the exploration. Some defects only show there.

        An episode that is not won is cut, unless it is short.
        """
        longest = max(int(_PATH * self._budget.steps), _SHORT_PATH)
        rollouts = []
        for number, outcome in enumerate(self.explorations):
            if win := outcome.get("win"):
                rollouts.append(self.script(number, win, "exploration"))
            if best := outcome.get("best"):
                rollouts.append(self.script(number, best[:longest], "exploration"))
        return self._cache.rollouts(rollouts)

    def best(self) -> Trace | None:
        """The best episode that exploration finds, a win before all others. Rare states lie on its way."""
        usable = [trace for trace in self.explored() if trace.usable and trace.steps]
        return max(usable, key=lambda trace: (trace.positive, trace.total), default=None)

    @cached_property
    def onward(self) -> list[Trace]:
        """Play that goes on after something happened: a success, a large reward, a loss. Some defects only show there.

        The first episode has as many steps as it can, since a limit may start again at the event.
        """
        left, most = self._budget.onward
        paths = self._events(left // most - _ONWARD)
        traces: list[Trace] = []
        for number in range(most if paths else 0):
            path, later = paths[number % len(paths)], most - number - 1
            rollout = next(itertools.islice(self._probes.onward(path), number, None))
            length = left // (later + 1) if number else left - later * (_ONWARD + max(map(_length, paths)))
            if length < len(path.actions) + _ONWARD:
                break
            traces.append(self._cache.rollout(rollout.cut(length)))
            left -= traces[-1].steps
        return traces

    def _events(self, longest: int) -> list[Rollout]:
        """The actions up to an event in the first `longest` steps, where the episode goes on: a success, or else the
        soonest large reward, the soonest loss, and the last large reward of the best play.
        """
        explored = [trace for trace in self.explored() if trace.usable]
        won = [trace.rollout.cut(trace.steps) for trace in explored if trace.positive and not trace.ended]
        if won:
            return [path for path in [min(won, key=_length)] if _length(path) <= longest]
        played = [*explored, *self._episodes.all]
        paid = [(trace, steps) for trace in played if (steps := _extremes(trace, 1, longest))]
        lost = [(trace, steps) for trace in played if (steps := _extremes(trace, -1, longest))]
        found = [min(events, key=lambda each: each[1][0]) for events in (paid, lost) if events]
        paths = [trace.rollout.cut(steps[0]) for trace, steps in found]
        if paid:
            trace, steps = max(paid, key=lambda each: sum(each[0].rewards[: each[1][-1]]))
            paths.append(trace.rollout.cut(steps[-1]))
        return list({path.key(): path for path in paths}.values())

    @cached_property
    def loops(self) -> list[tuple[int, list[Action], int]]:
        """Actions whose last ones pay each time that they are repeated: the number of the seed, the actions, and how
        many are repeated.

        Explorations find most of them. What has momentum needs two moves that are held in turn. These are tried where
        episodes without success are paid, if no play succeeds.
        """
        found = [
            (number, list(outcome.get("loop") or ()), outcome.get("loop_length") or 0)
            for number, outcome in enumerate(self.explorations)
        ]
        found = [loop for loop in found if loop[2]]
        if found or not self._budget.sweep or any(outcome.get("win") for outcome in self.explorations):
            return found
        played = [*self._episodes.all, *self.explored()]
        if any(trace.reported_success for trace in played):
            return []
        for trace, step in _soonest_paid(played):
            if not self._short and self._left_to_sweep < _ROCK:
                break
            seed, path = trace.rollout.seed, trace.actions[:step]
            outcome = self._cache.search(Search("rock", seed, step + _ROCK, path))
            if length := outcome.get("loop_length"):
                return [(seed - self._probes.episode_seed(0), list(outcome.get("loop") or ()), length)]
        return []

    def spares(self, steps: int) -> bool:
        """Whether a few more steps may be taken: the budget has them left, or all episodes are shorter than those that
        it is meant for.
        """
        return self._short or steps <= self._episodes.steps_left

    @property
    def _short(self) -> bool:
        return max(trace.steps for trace in self._episodes.whole) < self._probes.length

    def horizon(self, number: int = 0) -> SearchOutcome:
        """Play the episode by rolling-horizon search, to its end or a win: ``best`` has the actions."""
        return self._run("horizon", number, _HORIZON * self._probes.length)

    def exhaust(self, number: int = 0) -> SearchOutcome:
        """Search all reachable states."""
        return self._run("exhaust", number, self._exhaust_steps)

    @cached_property
    def _exhaust_steps(self) -> int:
        """The steps of a search through all states, which is a proof: only long episodes bind it to the budget."""
        left = self._cache.steps_left // _PROVEN if self._episodes.long else self._budget.exhaust
        return max(min(self._budget.exhaust, left), 0)

    @property
    def proven(self) -> range:
        """The numbers of the episode seeds on which a search through all states counts as a proof."""
        return range(max(len(self.explorations), _PROVEN))

    def unwinnable(self) -> tuple[list[int], int, int]:
        """Look for seeds on which no state is a win, by a short search for a win and a proof where that finds none.

        Returns:
            The numbers of the seeds on which all reachable states were searched without a win, and the states of all
            of them together; and how many seeds are settled.
        """
        found: list[int] = []
        states = settled = 0
        left = self._exhaust_steps // _PART
        while self._searchable and settled < _SEEDS * self._budget.random * (2 if found else 1):
            searched = self._run("reach", settled, left)
            left -= int(searched.get("steps") or 0)
            if not searched.get("win") and searched.get("exhausted") and left > 0:
                # A search that ends without a win is a strong sign, so the first proof gets more than its part.
                proof = left if found else self._exhaust_steps - self._exhaust_steps // _PART
                searched = self._run("exhaust", settled, proof)
                if found:
                    left -= int(searched.get("steps") or 0)
                if searched.get("exhausted"):
                    # One such seed is worth the search for another.
                    left += 0 if found else self._exhaust_steps // _PART
                    found.append(settled)
                    states += int(searched.get("states") or 0)
            if not (searched.get("win") or settled in found):
                break
            settled += 1
            if left <= 0:
                break
        return found, states, settled

    @property
    def _searchable(self) -> bool:
        return self.exhaustible and not any(outcome.get("stochastic") for outcome in self.explorations)

    @property
    def saturated(self) -> bool:
        """Whether no exploration met a new state in its second half, nor fewer states than a single episode."""
        alone = max(len(set(trace.observations)) for trace in self._episodes.whole)
        return not any(
            outcome.get("late_states") or int(outcome.get("states") or 0) < alone for outcome in self.explorations
        )

    @property
    def exhaustible(self) -> bool:
        """Whether the explorations saw so few states that a search may reach them all."""
        steps = self._exhaust_steps
        return all(
            int(outcome.get("states") or 0) * len(self._probes.joint_actions) <= steps for outcome in self.explorations
        )

    @property
    def sweep_steps(self) -> int:
        """The steps that are left for :meth:`sweep` and :meth:`sweep_last`."""
        # These come first, so that the steps that are left do not depend on which check is first.
        _ = self.loops
        return max(min(self._budget.sweep, self._left_to_sweep), 0)

    @property
    def _left_to_sweep(self) -> int:
        return self._episodes.steps_left - self._episodes.reserve - int(_LAST * self._budget.steps)

    def greedy(self, number: int = 0) -> SearchOutcome:
        """Five moves, each with the highest immediate reward."""
        return self._cache.search(self.greed(number))

    def greed(self, number: int) -> Search:
        """The search that :meth:`greedy` runs."""
        return Search("greedy", self._probes.episode_seed(number), _GREEDY)

    def sweep(self, path: list[Action], seed: int, budget: int) -> SearchOutcome:
        """Try actions on copies of the states along a path, in `budget` steps at most."""
        return self._cache.search(Search("sweep", seed, budget, path))

    def sweep_last(self, path: list[Action], seed: int, budget: int) -> SearchOutcome:
        """Try every action on copies of the states at the end of a path, in `budget` steps at most."""
        return self._cache.search(Search("sweep_last", seed, budget, path))

    def hidden_states(self, path: list[Action], seed: int) -> int:
        """How many states different moves lead to, after a path, that look like doing nothing (the worker's ``react``).

        It is 1 if no move has a lasting effect that the picture does not show, and 0 if that is not known.
        """
        return self._states("react", path, seed)

    def unseen_states(self, path: list[Action], seed: int) -> int:
        """The same, but 0 if the picture shows some move (the worker's ``vanish``)."""
        return self._states("vanish", path, seed)

    def enclosed(self) -> SearchOutcome:
        """Look for seeds on which walls enclose a thing that the player gathers; no result without the steps for it."""
        return self._run("enclosed", 0, _CELLS) if self.spares(_CELLS) else SearchOutcome()

    def outlast(self, counter: str, limit: int) -> list[Action]:
        """Look for play that starts a counter of steps again until the episode outlasts the contract's limit.

        Args:
            counter: the attribute that counts steps.
            limit: the number at which the counter ends an episode.

        Returns:
            The actions of such an episode; none if the search finds none, or if the budget has no steps for it.
        """
        steps = _OUTLAST * self._probes.length
        if not (self._budget.sweep and self.spares(steps)):
            return []
        search = Search("outlast", self._probes.episode_seed(0), steps, counter=(counter, limit))
        return list(self._cache.search(search).get("best") or ())

    def _states(self, kind: str, path: list[Action], seed: int) -> int:
        return int(self._cache.search(Search(kind, seed, len(path) + _REACT, path)).get("states") or 0)

    def script(self, number: int, chosen: Sequence[Action], player: str) -> Rollout:
        """A rollout of actions that a search found."""
        return Rollout(self._probes.episode_seed(number), list(chosen), player=player)

    def scripted(self, number: int, chosen: Sequence[Action], player: str) -> Trace:
        """The trace of actions that a search found."""
        return self._cache.rollout(self.script(number, chosen, player))

    def _run(self, kind: str, number: int, budget: int) -> SearchOutcome:
        return self._cache.search(Search(kind, self._probes.episode_seed(number), budget))


def _length(rollout: Rollout) -> int:
    return len(rollout.actions)


def _soonest_paid(traces: Sequence[Trace]) -> list[tuple[Trace, int]]:
    """The steps at which some episodes, whose info reports success or the lack of it, are first paid well."""
    found: dict[str, tuple[Trace, int]] = {}
    for trace in traces:
        if not trace.usable or trace.reported_success is None:
            continue
        usual = statistics.mode(trace.rewards)
        steps = (step for step, reward in enumerate(trace.rewards[:_SOON], 1) if reward > max(usual, 0))
        if step := next(steps, 0):
            found.setdefault(str((trace.rollout.seed, trace.actions[:step])), (trace, step))
    return sorted(found.values(), key=lambda each: each[1])[:_ROCKS]


def _extremes(trace: Trace, sign: int, longest: int) -> list[int]:
    """Those of the first `longest` steps that have the reward furthest above the usual one, or below it if `sign` is
    -1, where the episode goes on; none if all rewards are the usual one.
    """
    rewards = trace.rewards[: min(trace.steps - trace.ended, longest)]
    if not trace.usable or not rewards:
        return []
    usual = statistics.median(trace.rewards)
    offsets = [sign * (reward - usual) for reward in rewards]
    most = max(offsets)
    return [step for step, offset in enumerate(offsets, 1) if offset == most] if most > 0 else []
