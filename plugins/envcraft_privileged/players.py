"""Players for any environment: random actions, no action, and a search on copies of the state."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.demonstrations.player import Player

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace


class RandomPlayer(Player):
    name = "random"
    summary = "draws each action uniformly from the action space"

    def play(self, subject: Subject, number: int) -> Trace:
        return subject.random(number)


class NoopPlayer(Player):
    name = "noop"
    summary = "does nothing, if the contract defines an action for that"

    def play(self, subject: Subject, number: int) -> Trace:
        return subject.noop(number)


class SearchPlayer(Player):
    """Explores like the check `difficulty`; if that finds no win, it plans with a rolling horizon.

    Both searches run in the worker, on copies of the environment or, if it cannot be copied, by replaying actions. The
    actions that they return are then played in a fresh episode.
    """

    name = "search"
    summary = "searches ahead on copies of the state"

    def play(self, subject: Subject, number: int) -> Trace:
        chosen = subject.searches.explore(number).get("win") or subject.searches.horizon(number).get("best")
        # A search without a result still leaves an episode to play.
        return subject.searches.scripted(number, chosen, "the search player") if chosen else subject.random(number)
