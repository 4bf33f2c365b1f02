"""Searches in the worker. Their outcomes are advice: a rollout must confirm each."""

from __future__ import annotations

from collections.abc import Sequence

from envcraft.judging.budget import Budget
from envcraft.judging.probes import Probes
from envcraft.judging.rollout_cache import RolloutCache
from envcraft.model.job import SearchOutcome
from envcraft.model.rollout import Action, Rollout, Search
from envcraft.model.trace import Trace

#: Steps that a rolling-horizon search may try for each step of the episode.
_HORIZON = 40
#: Steps of a greedy search, which makes five moves.
_GREEDY = 10_000


class Searches:
    """The searches of one subject, each run once, as far as the budget allows. A `number` selects an episode seed."""

    def __init__(self, cache: RolloutCache, probes: Probes, budget: Budget) -> None:
        self._cache = cache
        self._probes = probes
        self._budget = budget

    def explore(self, number: int = 0) -> SearchOutcome:
        """Search for crashes and wins (see the worker's ``explore``)."""
        return self._cache.search(self._exploration(number))

    def explorations(self) -> list[Search]:
        """The searches that :meth:`explored` requests first."""
        return [self._exploration(number) for number in range(self._budget.explore[1])]

    def explored(self) -> list[Trace]:
        """Traces of the shortest wins and the best episodes of the exploration. Some defects only show there."""
        self._cache.prefetch(self.explorations())
        outcomes = [self.explore(number) for number in range(self._budget.explore[1])]
        paths = ((number, path) for number, one in enumerate(outcomes) for path in (one.get("win"), one.get("best")))
        return self._cache.rollouts([self.script(number, path, "exploration") for number, path in paths if path])

    def best(self) -> Rollout | None:
        """The best episode that exploration finds, a win before all others. Rare states lie on its way."""
        usable = [trace for trace in self.explored() if trace.usable and trace.steps]
        best = max(usable, key=lambda trace: (trace.positive, trace.total), default=None)
        return best.rollout if best is not None else None

    def horizon(self, number: int = 0) -> SearchOutcome:
        """Play the episode by rolling-horizon search, to its end or a win: ``best`` has the actions."""
        return self._run("horizon", number, _HORIZON * self._probes.length)

    def exhaust(self, number: int = 0) -> SearchOutcome:
        """Search all reachable states."""
        return self._run("exhaust", number, self._budget.exhaust)

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

    def script(self, number: int, chosen: Sequence[Action], player: str) -> Rollout:
        """A rollout of actions that a search found."""
        return Rollout(self._probes.episode_seed(number), list(chosen), player=player)

    def scripted(self, number: int, chosen: Sequence[Action], player: str) -> Trace:
        """The trace of actions that a search found."""
        return self._cache.rollout(self.script(number, chosen, player))

    def _exploration(self, number: int) -> Search:
        return Search("explore", self._probes.episode_seed(number), self._budget.explore[0])

    def _run(self, kind: str, number: int, budget: int) -> SearchOutcome:
        return self._cache.search(Search(kind, self._probes.episode_seed(number), budget))
