"""The learning curve of a training, stored as JSON lines."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from envcraft_dqn.callbacks import EpisodeStatistics
from envcraft_dqn.files import write_atomically

#: The number of points per phase.
POINTS = 100
#: The minimum number of episodes in a mean. With fewer, episodes count towards the next point.
_MIN_EPISODES = 10


class LearningCurve(EpisodeStatistics):
    """Writes points to `file`: means over the updates and the finished episodes since the last point.

    A run that resumes from a checkpoint removes the points after it.
    """

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file
        self._points = read(file)
        self.on_phase_start("", 0, 0)

    def on_phase_start(self, phase: str, done: int, total: int, updates: int = 0) -> None:
        self._phase, self._interval = phase, max(total / POINTS, 1.0)
        self._next = (done // self._interval + 1) * self._interval
        self._points = [point for point in self._points if point["phase"] != phase or point["done"] <= done]

    def on_progress(self, steps: int, updates: int, done: int, epsilon: float | None = None) -> None:
        if done < self._next:
            return
        self._next = (done // self._interval + 1) * self._interval
        point = {"phase": self._phase, "done": done, "steps": steps, "updates": updates}
        for name, values, minimum in (
            ("loss", self._losses, 1),
            ("return", self._returns, _MIN_EPISODES),
            ("length", self._lengths, _MIN_EPISODES),
        ):
            point[name] = float(np.mean(values)) if len(values) >= minimum else None
            if len(values) >= minimum:
                values.clear()
        self._points.append(point)
        # Earlier points exist only in this file, so a killed process must not truncate it.
        write_atomically(self._file, "".join(f"{json.dumps(one)}\n" for one in self._points))


def read(file: Path) -> list[dict[str, Any]]:
    """The points of a curve, or none without a file. An incomplete last line is ignored."""
    if not file.is_file():
        return []
    lines = file.read_text("utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]
