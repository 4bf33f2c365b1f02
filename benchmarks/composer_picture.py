"""``python -m benchmarks.composer_picture``: draw ``docs/composer.png``, frames of sixty composed games."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from envcraft_composer.family import ComposerFamily
from envcraft_composer.policy import Composed
from numpy.typing import NDArray

from benchmarks.composer import load_game

ROOT = Path(__file__).resolve().parent.parent
COUNT, COLUMNS = 60, 12
#: Each picture is that of the player after so many steps.
STEPS = 12
SCALE = 2


def main() -> None:
    from PIL import Image

    frames = []
    for one in ComposerFamily().generate(COUNT, 0):
        frame = _frame(load_game(one.source))
        frames.append(np.pad(frame, ((2, 2), (2, 2), (0, 0)), constant_values=255))
    rows = [np.concatenate(frames[start : start + COLUMNS], axis=1) for start in range(0, COUNT, COLUMNS)]
    image = Image.fromarray(np.concatenate(rows))
    larger = image.resize((SCALE * image.width, SCALE * image.height), Image.Resampling.NEAREST)
    larger.quantize(256).save(ROOT / "docs" / "composer.png", optimize=True)


def _frame(env: Any) -> NDArray[np.uint8]:
    """A frame of the game, uint8, shape (84, 84, 3)."""
    frame, _ = env.reset(seed=2)
    player = Composed()
    for _ in range(STEPS):
        frame, _, terminated, truncated, _ = env.step(player.act(env))
        if terminated or truncated:
            break
    return np.asarray(frame)


if __name__ == "__main__":
    main()
