"""The player `edge`: walks to one side and stays there."""

from __future__ import annotations

from envcraft.demonstrations.player import Player
from envcraft.judging.subject import Subject
from envcraft.model.rollout import Rollout
from envcraft.model.trace import Trace

_LEFT, _RIGHT = [3, 0, 0], [4, 0, 0]


class EdgePlayer(Player):
    name = "edge"
    summary = "holds left in one episode and right in the next"
    families = ("doors",)

    def play(self, subject: Subject, number: int) -> Trace:
        actions = [_RIGHT if number % 2 else _LEFT] * subject.length
        return subject.rollout(Rollout(subject.episode_seed(number), actions, player="walking to the edge"))
