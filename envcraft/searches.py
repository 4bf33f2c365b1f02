"""What searches in the worker find of one environment: advice, to be confirmed by rollouts of what they found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from envcraft.description import Outcome
from envcraft.rollout import Action, Rollout

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace

#: Steps that the player of a rolling horizon may try for each that it plays.
_HORIZON = 40
#: Steps of a greedy search, which makes five moves.
_GREEDY = 10_000


class Search(msgspec.Struct, frozen=True):
    """A search in the worker, of `budget` environment steps at the most; `path` is what it follows, if anything."""

    kind: str
    seed: int
    budget: int
    path: list[Action] = []

    def key(self) -> bytes:
        return msgspec.json.encode((self.kind, self.seed, self.budget, self.path))


class Searches:
    """The searches of one subject, each run once, as its budget allows. A `number` is that of an episode's seed."""

    def __init__(self, subject: Subject) -> None:
        self._subject = subject
        self._budget = subject.budget

    def explore(self, number: int = 0) -> Outcome:
        """Search for crashes and wins (see the worker's ``explore``)."""
        return self._subject.search(self._exploration(number))

    def explorations(self) -> list[Search]:
        """What :meth:`explored` asks for first."""
        return [self._exploration(number) for number in range(self._budget.explore[1])]

    def explored(self) -> list[Trace]:
        """The shortest wins and the best episodes that exploration found, stepped: some things only show there."""
        self._subject.foresee(self.explorations())
        told = [self.explore(number) for number in range(self._budget.explore[1])]
        found = ((number, path) for number, one in enumerate(told) for path in (one.get("win"), one.get("best")))
        return self._subject.rollouts([self.script(number, path, "exploration") for number, path in found if path])

    def best(self) -> Rollout | None:
        """The best that exploration found, a win before all others: what nobody meets by chance lies on its way."""
        usable = [trace for trace in self.explored() if trace.usable and trace.steps]
        best = max(usable, key=lambda trace: (trace.positive, trace.total), default=None)
        return best.rollout if best is not None else None

    def horizon(self, number: int = 0) -> Outcome:
        """Play the episode by rolling horizon, to its end or a win: ``best`` has the actions."""
        return self._run("horizon", number, _HORIZON * self._subject.length)

    def exhaust(self, number: int = 0) -> Outcome:
        """Search through all states that can be reached."""
        return self._run("exhaust", number, self._budget.exhaust)

    def greedy(self, number: int = 0) -> Outcome:
        """Five moves, each with the highest immediate reward."""
        return self._subject.search(self.greed(number))

    def greed(self, number: int) -> Search:
        """What :meth:`greedy` asks for."""
        return Search("greedy", self._subject.episode_seed(number), _GREEDY)

    def sweep(self, path: list[Action], seed: int, budget: int) -> Outcome:
        """Try actions on copies of the states along a path, in so many steps at the most."""
        return self._subject.search(Search("sweep", seed, budget, path))

    def sweep_last(self, path: list[Action], seed: int, budget: int) -> Outcome:
        """Try every action on copies of the states at the end of a path, in so many steps at the most."""
        return self._subject.search(Search("sweep_last", seed, budget, path))

    def script(self, number: int, chosen: Sequence[Action], player: str) -> Rollout:
        """An action list that a search found, to be stepped for real."""
        return Rollout(self._subject.episode_seed(number), list(chosen), player=player)

    def scripted(self, number: int, chosen: Sequence[Action], player: str) -> Trace:
        """An action list that a search found, stepped for real."""
        return self._subject.rollout(self.script(number, chosen, player))

    def _exploration(self, number: int) -> Search:
        return Search("explore", self._subject.episode_seed(number), self._budget.explore[0])

    def _run(self, kind: str, number: int, budget: int) -> Outcome:
        return self._subject.search(Search(kind, self._subject.episode_seed(number), budget))
