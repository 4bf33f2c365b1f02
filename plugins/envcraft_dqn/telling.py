"""How far a run has come: a bar with the time left on stderr, and curves for TensorBoard."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Episodes and updates that a mean is taken over, and seconds between two points of a curve.
_LAST = 100
_EVERY = 5.0
#: Seconds between two looks at the bar.
_REFRESH = 0.2


class Teller:
    """Takes in what happens in a run, and tells it nowhere: in a library's hands training is silent."""

    def begin(self, phase: str, done: int, total: int, updates: int = 0) -> None:
        """A phase begins, or goes on after `done` of `total`, when there have been so many updates in all."""

    def updated(self, loss: float) -> None:
        """An update was made."""

    def reset(self, lanes: int) -> None:
        """All lanes begin new episodes."""

    def stepped(self, lanes: NDArray[np.int64], rewards: NDArray[Any], over: NDArray[np.bool_]) -> None:
        """The environments in some `lanes` were stepped; `rewards` and `over` are of all lanes."""

    def progress(self, steps: int, updates: int, done: int, epsilon: float | None = None) -> None:
        """So much of the phase is `done`."""


class Counter(Teller):
    """Keeps losses, and of episodes that have ended their returns and lengths: of each the last `most`, or all."""

    def __init__(self, most: int | None = None) -> None:
        self._losses: deque[float] = deque(maxlen=most)
        self._returns: deque[float] = deque(maxlen=most)
        self._lengths: deque[int] = deque(maxlen=most)
        self.reset(0)

    def updated(self, loss: float) -> None:
        self._losses.append(loss)

    def reset(self, lanes: int) -> None:
        self._sums, self._counts = np.zeros(lanes), np.zeros(lanes, np.int64)

    def stepped(self, lanes: NDArray[np.int64], rewards: NDArray[Any], over: NDArray[np.bool_]) -> None:
        self._sums[lanes] += rewards[lanes]
        self._counts[lanes] += 1
        if over.any():
            self._returns.extend(self._sums[over].tolist())
            self._lengths.extend(self._counts[over].tolist())
            self._sums[over], self._counts[over] = 0.0, 0


class Shown(Counter):
    """Tells it on a terminal, and in event files in `folder`."""

    def __init__(self, folder: Path) -> None:
        super().__init__(_LAST)
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[told]}"),
        )
        self._bar = Progress(*columns, console=Console(stderr=True))
        self._folder = folder
        self._writer: Any = None
        self._now: tuple[int, int, float | None] | None = None

    def __enter__(self) -> Shown:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._bar.stop()
        if self._writer is not None:
            with contextlib.suppress(OSError):
                self._draw()
                self._writer.close()

    def begin(self, phase: str, done: int, total: int, updates: int = 0) -> None:
        self._total = total
        # Not before there is something to do: a run that is refused leaves no empty curves.
        if total > done and self._writer is None:
            from torch.utils.tensorboard import SummaryWriter

            # What an interrupted run drew after its last checkpoint comes again.
            self._writer = SummaryWriter(str(self._folder), purge_step=updates)
        self._phase = self._bar.add_task(phase, total=total, completed=done, told="", visible=total > 0)
        self._at: tuple[float, int, int] | None = None
        self._drawn = 0.0

    def progress(self, steps: int, updates: int, done: int, epsilon: float | None = None) -> None:
        now = time.monotonic()
        self._now = steps, updates, epsilon
        if now - self._drawn < _REFRESH and done < self._total:
            return
        self._drawn = now
        self._bar.update(self._phase, completed=done, told=self._words())
        if self._at is not None and now - self._at[0] < _EVERY:
            return
        if self._at is not None:
            seconds = now - self._at[0]
            self._tell("speed/steps", (steps - self._at[1]) / seconds, updates)
            self._tell("speed/updates", (updates - self._at[2]) / seconds, updates)
        self._at = now, steps, updates
        self._draw()

    def _draw(self) -> None:
        """A point of each curve, unless there was one already."""
        if self._now is None:
            return
        (steps, updates, epsilon), self._now = self._now, None
        self._tell("progress/steps", steps, updates)
        self._tell("progress/epsilon", epsilon, updates)
        for name, values in (
            ("loss", self._losses),
            ("episode/return", self._returns),
            ("episode/length", self._lengths),
        ):
            self._tell(name, float(np.mean(values)) if values else None, updates)

    def _words(self) -> str:
        parts = [f"loss {np.mean(self._losses):.3g}"] if self._losses else []
        if self._returns:
            parts.append(f"return {np.mean(self._returns):.3g}, length {np.mean(self._lengths):.0f}")
        return "  ".join(parts)

    def _tell(self, name: str, value: float | None, updates: int) -> None:
        # Drawn over updates, which come first in pretraining and then with the steps.
        if value is not None:
            self._writer.add_scalar(name, value, updates)
