"""What Python calls: many games begun or stepped, each with its frame, in one go."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from .compiling import entry
from .drawing import UNDRAWN, clean, draw
from .rules import MAX_STEPS, begin, step

#: numba keeps machine code by this file's time and size, and by the values that a function takes from where it is
#: defined; that other files have changed shows in this one alone.
_SOURCES = hashlib.sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
).hexdigest()


#: What a game does.
NOTHING, STEP, BEGIN = range(3)


def _compiled(sources: str) -> Any:
    @entry
    def play(
        rules: Any,
        which: Any,
        games: Any,
        doing: Any,
        actions: Any,
        rewards: Any,
        terminated: Any,
        truncated: Any,
        frames: Any,
    ) -> None:
        """Let each game do what `doing` says; a frame that shows nothing yet is drawn from the ground up."""
        sources  # noqa: B018 (part of the key)
        for number in range(games.shape[0]):
            if doing[number] == NOTHING:
                continue
            own, game = rules[which[number]], games[number]
            if doing[number] == STEP:
                step(own, game, actions[number, 0], actions[number, 1], actions[number, 2])
            else:
                begin(own, game)
                if game.shown_time == UNDRAWN:
                    clean(own, game, frames[number])
            rewards[number] = game.reward
            terminated[number] = game.won != 0 or game.lost != 0
            truncated[number] = game.steps >= MAX_STEPS and not terminated[number]
            draw(own, game, frames[number])

    return play


play = _compiled(_SOURCES)
