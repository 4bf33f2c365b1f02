"""Players that know no game: chance, doing nothing, and a search on copies of the state."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.demonstrations.player import Player

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace


class RandomPlayer(Player):
    name = "random"
    summary = "each action drawn evenly from the action space"

    def play(self, subject: Subject, number: int) -> Trace:
        return subject.random(number)


class NoopPlayer(Player):
    name = "noop"
    summary = "does nothing, where the contract knows how"

    def play(self, subject: Subject, number: int) -> Trace:
        return subject.noop(number)


class SearchPlayer(Player):
    """Explores as the check `difficulty` does; where that finds no win, it plays the episode by rolling horizon.

    Both search in the worker, on copies of the environment or by playing its actions again where it cannot be copied,
    and what they find is stepped for real.
    """

    name = "search"
    summary = "searches ahead on copies of the state, in any environment"

    def play(self, subject: Subject, number: int) -> Trace:
        chosen = subject.searches.explore(number).get("win") or subject.searches.horizon(number).get("best")
        # A search that found nothing to do still leaves an episode to play.
        return subject.searches.scripted(number, chosen, "the search player") if chosen else subject.random(number)
