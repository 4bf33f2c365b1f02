"""Players from files: ``--player tape:PATH`` plays the actions of a JSON list, again and again."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

from envcraft.demonstrations.player import Player, PlayerLoader
from envcraft.errors import UsageError
from envcraft.judging.subject import Subject
from envcraft.model.rollout import Rollout
from envcraft.model.trace import Trace


class TapePlayer(Player):
    name = "tape"
    summary = "plays a list of actions, again and again"

    def __init__(self, actions: list[Any]) -> None:
        self._actions = actions

    def play(self, subject: Subject, number: int) -> Trace:
        actions = list(itertools.islice(itertools.cycle(self._actions), subject.length))
        return subject.rollout(Rollout(subject.episode_seed(number), actions, player="the tape"))


class TapeLoader(PlayerLoader):
    name = "tape"
    summary = "plays the JSON list of actions of a file, again and again"

    def load(self, path: Path) -> Player:
        try:
            actions = json.loads(path.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise UsageError(f"{path} is no JSON list of actions: {error}") from None
        if not isinstance(actions, list) or not actions:
            raise UsageError(f"{path} is no JSON list of actions")
        return TapePlayer(actions)
