"""What Python calls: many games begun or stepped, each with its frame, in one go."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from .compiling import entry
from .drawing import clean, draw
from .rules import MAX_STEPS, begin
from .rules import step as step_game

#: numba keeps machine code by this file's time and size, and by the values that a function takes from where it is
#: defined; that other files have changed shows in this one alone.
_SOURCES = hashlib.sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
).hexdigest()


def _compiled(sources: str) -> tuple[Any, Any]:
    @entry
    def reset(rules: Any, which: Any, games: Any, wanted: Any, frames: Any) -> None:
        """Begin the games where `wanted` is True; a frame that shows nothing yet is drawn from the ground up."""
        sources  # noqa: B018 (part of the key)
        for number in range(games.shape[0]):
            if wanted[number]:
                own, game = rules[which[number]], games[number]
                if game.shown_time < -1:
                    clean(own, game, frames[number])
                begin(own, game)
                draw(own, game, frames[number])

    @entry
    def step(
        rules: Any,
        which: Any,
        games: Any,
        waiting: Any,
        actions: Any,
        rewards: Any,
        terminated: Any,
        truncated: Any,
        frames: Any,
    ) -> None:
        """Step each game, or begin it anew where `waiting` is True."""
        sources  # noqa: B018 (part of the key)
        for number in range(games.shape[0]):
            own, game = rules[which[number]], games[number]
            if waiting[number]:
                begin(own, game)
            else:
                action = actions[number]
                step_game(own, game, action[0], action[1] != 0, action[2] != 0)
            rewards[number] = game.reward
            terminated[number] = game.won != 0 or game.lost != 0
            truncated[number] = game.steps >= MAX_STEPS and not terminated[number]
            draw(own, game, frames[number])

    return reset, step


reset, step = _compiled(_SOURCES)
