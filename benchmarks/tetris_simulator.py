"""``python -m benchmarks.tetris_simulator``: whether the vectorized simulator of Tetris matches the generated sources.

It compares every frame, reward, flag, info and generator state of the variants that `envcraft generate --family tetris
--count 1000 --seed 0` writes (see :mod:`envcraft_tetris.equivalence`). Exit status 1 if anything differs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

from envcraft_tetris.equivalence import compare
from envcraft_tetris.family import TetrisFamily

_SHOWN = 5


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the events and the differences; return 1 if there are differences."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tetris_simulator", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="number of variants")
    parser.add_argument("--steps", type=int, default=1000, help="steps of each variant")
    parser.add_argument("--seed", type=int, default=0, help="seed of the family, the games and the actions")
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    events, differences = compare(
        list(TetrisFamily().generate(options.count, options.seed)), options.steps, options.seed
    )
    counts = ", ".join(f"{events[key]:,} {key}" for key in ("steps", "episodes", "won", "truncated", "cleared"))
    print(f"{options.count:,} variants: {counts}, in {time.perf_counter() - started:.0f} s")
    for line in differences[:_SHOWN]:
        print(f"different: {line}")
    print(f"{options.count - len(differences):,} of {options.count:,} variants match in every step")
    return int(bool(differences))


if __name__ == "__main__":
    raise SystemExit(main())
