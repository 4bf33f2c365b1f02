"""The learning curve of one training, a line of JSON a point, which outlives the process that trains."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from envcraft_dqn.telling import Counter

#: Of each phase.
POINTS = 100
#: That a mean over episodes is taken over at least: with fewer, they wait for the next point.
_EPISODES = 10


class Curve(Counter):
    """Writes points into `file`: means since the last one, over updates and over episodes that ended by themselves.

    A run that goes on from a checkpoint takes back the points that came after it.
    """

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file
        self._points = read(file)
        self.begin("", 0, 0)

    def begin(self, phase: str, done: int, total: int, updates: int = 0) -> None:
        self._phase, self._each = phase, max(total / POINTS, 1.0)
        self._next = (done // self._each + 1) * self._each
        self._points = [point for point in self._points if point["phase"] != phase or point["done"] <= done]

    def progress(self, steps: int, updates: int, done: int, epsilon: float | None = None) -> None:
        if done < self._next:
            return
        self._next = (done // self._each + 1) * self._each
        point = {"phase": self._phase, "done": done, "steps": steps, "updates": updates}
        for name, values, least in (
            ("loss", self._losses, 1),
            ("return", self._returns, _EPISODES),
            ("length", self._lengths, _EPISODES),
        ):
            point[name] = float(np.mean(values)) if len(values) >= least else None
            if len(values) >= least:
                values.clear()
        self._points.append(point)
        self._file.parent.mkdir(parents=True, exist_ok=True)
        # A run that is killed here goes on from a checkpoint, and has the points before that in this file alone.
        new = self._file.with_suffix(".new")
        new.write_text("".join(f"{json.dumps(one)}\n" for one in self._points), "utf-8")
        os.replace(new, self._file)


def read(file: Path) -> list[dict[str, Any]]:
    """The points of a curve; none where there is no such file. A line that was being written is left out."""
    if not file.is_file():
        return []
    lines = file.read_text("utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]
