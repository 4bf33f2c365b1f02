"""``python -m benchmarks.family_picture``: draw ``docs/tetris.png``, frames of thirty Tetris variants."""

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
#: The picture shows every 33rd of the first thousand variants, after 70% of an episode of random play.
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
            # Trusted: this repository's templates wrote it.
            frames.append(
                np.pad(_frame(envcraft.make(path, trust=True)), ((2, 2), (2, 2), (0, 0)), constant_values=255)
            )
    rows = [np.concatenate(frames[start : start + COLUMNS], axis=1) for start in range(0, COUNT, COLUMNS)]
    image = Image.fromarray(np.concatenate(rows))
    larger = image.resize((SCALE * image.width, SCALE * image.height), Image.Resampling.NEAREST)
    larger.quantize(256).save(ROOT / "docs" / "tetris.png", optimize=True)


def _frame(env: Any) -> NDArray[np.uint8]:
    """A frame of the game, uint8, shape (84, 84, 3)."""
    frames = [env.reset(seed=2)[0]]
    for action in np.random.default_rng(2).integers(0, (5, 2, 2), (1000, 3)):
        frame, _, terminated, truncated, _ = env.step(action)
        frames.append(frame)
        if terminated or truncated:
            break
    return np.asarray(frames[int(AT * len(frames))])


if __name__ == "__main__":
    main()
