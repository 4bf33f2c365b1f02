"""``python -m benchmarks.bare FILE``: play episodes of the environment in FILE in a plain loop, without a sandbox.

Reads one line of JSON for each episode, ``{"seed": 0, "actions": [...]}``, and answers with the number of steps, the
wall-clock seconds and the CPU seconds of the episode.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from pathlib import Path
from typing import Any, TextIO

import gymnasium
import numpy as np


def environment(path: Path) -> gymnasium.Env[Any, Any]:
    """An instance of the only environment that a file defines."""
    spec = importlib.util.spec_from_file_location("bare_game", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    kinds = [value for value in vars(module).values() if isinstance(value, type) and value.__module__ == "bare_game"]
    (kind,) = (kind for kind in kinds if issubclass(kind, gymnasium.Env))
    made: gymnasium.Env[Any, Any] = kind()
    return made


def play(env: gymnasium.Env[Any, Any], seed: int, actions: list[Any]) -> tuple[int, float, float]:
    """Play one episode; return its steps, seconds and CPU seconds."""
    prepared = [np.array(action) for action in actions]
    started, cpu = time.perf_counter(), time.process_time()
    env.reset(seed=seed)
    steps = 0
    for action in prepared:
        _, _, terminated, truncated, _ = env.step(action)
        steps += 1
        if terminated or truncated:
            break
    return steps, time.perf_counter() - started, time.process_time() - cpu


def main(path: Path, requests: TextIO, answers: TextIO) -> None:
    env = environment(path)
    for line in requests:
        print(json.dumps(play(env, **json.loads(line))), file=answers, flush=True)
    env.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.stdin, sys.stdout)
