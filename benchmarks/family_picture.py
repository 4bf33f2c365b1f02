"""``python -m benchmarks.family_picture``: draw ``docs/tetris.png``, thirty variants of the family at play."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from envcraft_tetris.family import TetrisFamily
from numpy.typing import NDArray

import envcraft

ROOT = Path(__file__).resolve().parent.parent
COUNT, COLUMNS = 30, 10
#: Every so many-th of the first thousand is shown, so late in a game of random actions.
EVERY, AT = 33, 0.7
SCALE = 2


def main() -> None:
    from PIL import Image

    chosen = list(TetrisFamily().generate(EVERY * COUNT, 0))[::EVERY]
    with tempfile.TemporaryDirectory() as folder:
        frames = []
        for one in chosen:
            path = Path(folder, f"{one.name}.py")
            path.write_text(one.source, "utf-8")
            # Nothing but this repository's own templates has written it.
            frames.append(
                np.pad(_frame(envcraft.make(path, trust=True)), ((2, 2), (2, 2), (0, 0)), constant_values=255)
            )
    rows = [np.concatenate(frames[start : start + COLUMNS], axis=1) for start in range(0, COUNT, COLUMNS)]
    image = Image.fromarray(np.concatenate(rows))
    larger = image.resize((SCALE * image.width, SCALE * image.height), Image.Resampling.NEAREST)
    larger.quantize(256).save(ROOT / "docs" / "tetris.png", optimize=True)


def _frame(env: Any) -> NDArray[np.uint8]:
    """A frame of a game, uint8, shape (84, 84, 3)."""
    frames = [env.reset(seed=2)[0]]
    for action in np.random.default_rng(2).integers(0, (5, 2, 2), (1000, 3)):
        frame, _, terminated, truncated, _ = env.step(action)
        frames.append(frame)
        if terminated or truncated:
            break
    return np.asarray(frames[int(AT * len(frames))])


if __name__ == "__main__":
    main()
