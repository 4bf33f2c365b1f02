"""The learning curve of one training, a line of JSON a point, which outlives the process that trains."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft_dqn.telling import Teller

#: Of each phase.
POINTS = 100
#: That a mean over episodes is taken over at least: with fewer, they wait for the next point.
_EPISODES = 10


class Curve(Teller):
    """Writes points into `file`: means since the last one, over updates and over episodes that ended by themselves.

    A run that goes on from a checkpoint takes back the points that came after it.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._points = read(file)
        self._losses: list[float] = []
        self._returns: list[float] = []
        self._lengths: list[int] = []
        self.begin("", 0, 0)
        self.reset(0)

    def begin(self, phase: str, done: int, total: int) -> None:
        self._phase, self._each = phase, max(total / POINTS, 1.0)
        self._next = (done // self._each + 1) * self._each
        self._points = [point for point in self._points if point["phase"] != phase or point["done"] <= done]

    def updated(self, loss: float) -> None:
        self._losses.append(loss)

    def reset(self, lanes: int) -> None:
        self._sums, self._counts = np.zeros(lanes), np.zeros(lanes, np.int64)

    def stepped(self, lanes: NDArray[np.int64], rewards: NDArray[Any], over: NDArray[np.bool_]) -> None:
        self._sums[lanes] += rewards[lanes]
        self._counts[lanes] += 1
        if over.any():
            self._returns += self._sums[over].tolist()
            self._lengths += self._counts[over].tolist()
            self._sums[over], self._counts[over] = 0.0, 0

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
        self._file.write_text("".join(f"{json.dumps(one)}\n" for one in self._points), "utf-8")


def read(file: Path) -> list[dict[str, Any]]:
    """The points of a curve; none where there is no such file. A line that was being written is left out."""
    if not file.is_file():
        return []
    lines = file.read_text("utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]
