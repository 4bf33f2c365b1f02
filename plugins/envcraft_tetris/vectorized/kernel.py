"""The compiled entry point: resets or steps many games and renders their frames."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from envcraft_tetris.vectorized.jit import entry
from envcraft_tetris.vectorized.rendering import UNDRAWN, draw, draw_background
from envcraft_tetris.vectorized.rules import MAX_STEPS, reset, step

#: numba caches by the time and size of this file and by the closure of the function. The closure holds this digest, so
#: that a change in another file of the package invalidates the cache.
_SOURCES = hashlib.sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
).hexdigest()


#: What a game does in one call.
NOTHING, STEP, RESET = range(3)


def _compiled(sources: str) -> Any:
    @entry
    def play(
        rules: Any,
        which: Any,
        games: Any,
        operations: Any,
        actions: Any,
        rewards: Any,
        terminated: Any,
        truncated: Any,
        frames: Any,
    ) -> None:
        """Apply `operations` to the games. A frame that has not been rendered yet is rendered in full."""
        sources  # noqa: B018 (part of the cache key)
        for number in range(games.shape[0]):
            if operations[number] == NOTHING:
                continue
            own, game = rules[which[number]], games[number]
            if operations[number] == STEP:
                step(own, game, actions[number, 0], actions[number, 1], actions[number, 2])
            else:
                reset(own, game)
                if game.shown_time == UNDRAWN:
                    draw_background(own, game, frames[number])
            rewards[number] = game.reward
            terminated[number] = game.won != 0 or game.lost != 0
            truncated[number] = game.steps >= MAX_STEPS and not terminated[number]
            draw(own, game, frames[number])

    return play


play = _compiled(_SOURCES)
