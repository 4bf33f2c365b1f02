"""Callbacks of a training run: episode statistics, a progress bar on stderr, and curves for TensorBoard."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: The number of episodes and updates in a mean, and the seconds between two points of a curve.
_WINDOW = 100
_LOG_SECONDS = 5.0
#: Seconds between two refreshes of the progress bar.
_REFRESH_SECONDS = 0.2
#: The columns beside the progress bar.
_TEXT = 76


class Callback:
    """Receives the events of a training run. This base class ignores them."""

    def on_phase_start(self, phase: str, done: int, total: int, updates: int = 0) -> None:
        """A phase starts or resumes.

        Args:
            phase: The name of the phase.
            done, total: The completed and the total steps or updates of the phase.
            updates: The updates of the run so far.
        """

    def on_update(self, loss: float) -> None:
        """The learner made an update."""

    def on_reset(self, num_envs: int, names: Sequence[str] = ()) -> None:
        """All environments were reset; `names` are theirs, if they are known."""

    def on_act(self, actions: NDArray[np.int64], gaps: NDArray[np.float32]) -> None:
        """The learner chose joint actions [n]. `gaps` [n] are the leads of the best values over the second best."""

    def on_step(self, indices: NDArray[np.int64], rewards: NDArray[Any], dones: NDArray[np.bool_]) -> None:
        """The environments were stepped.

        Args:
            indices: The environments that took a step, [n].
            rewards, dones: The rewards and episode ends of all environments, [num_envs].
        """

    def on_held_out(self, score: float, updates: int) -> None:
        """The agent was tested in held-out environments (:class:`envcraft_dqn.held_out.HeldOut`)."""

    def on_progress(self, steps: int, updates: int, done: int, epsilon: float | None = None) -> None:
        """The run advanced: `steps` and `updates` in total, and `done` in the phase."""


class EpisodeStatistics(Callback):
    """Collects losses and the returns and lengths of finished episodes: the last `window` of each, or all."""

    def __init__(self, window: int | None = None) -> None:
        self._losses: deque[float] = deque(maxlen=window)
        self._returns: deque[float] = deque(maxlen=window)
        self._lengths: deque[int] = deque(maxlen=window)
        self.on_reset(0)

    def on_update(self, loss: float) -> None:
        self._losses.append(loss)

    def on_reset(self, num_envs: int, names: Sequence[str] = ()) -> None:
        self._sums, self._counts = np.zeros(num_envs), np.zeros(num_envs, np.int64)

    def on_step(self, indices: NDArray[np.int64], rewards: NDArray[Any], dones: NDArray[np.bool_]) -> None:
        self._sums[indices] += rewards[indices]
        self._counts[indices] += 1
        if dones.any():
            self._returns.extend(self._sums[dones].tolist())
            self._lengths.extend(self._counts[dones].tolist())
            self._sums[dones], self._counts[dones] = 0.0, 0


class ProgressLogger(EpisodeStatistics):
    """Shows progress on a terminal, and writes TensorBoard event files into `folder`. Use as a context manager."""

    def __init__(self, folder: Path) -> None:
        super().__init__(_WINDOW)
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
        from rich.table import Column

        console = Console(stderr=True)
        # In a narrow terminal the bar is shorter and the statistics wrap, and no number is cut.
        columns = (
            TextColumn("{task.description}"),
            BarColumn(max(min(console.width - _TEXT, 40), 4)),
            MofNCompleteColumn(table_column=Column(no_wrap=True)),
            TimeRemainingColumn(table_column=Column(no_wrap=True)),
            TextColumn("{task.fields[statistics]}", table_column=Column()),
        )
        self._bar = Progress(*columns, console=console)
        self._folder = folder
        self._writer: Any = None
        self._pending: tuple[int, int, float | None] | None = None
        self._names: Sequence[str] = ()
        #: Since the last point: the returns of episodes by environment, and the actions and gaps of the learner.
        self._by_name: dict[str, list[float]] = {}
        self._actions: list[NDArray[np.int64]] = []
        self._gaps: list[NDArray[np.float32]] = []

    def on_reset(self, num_envs: int, names: Sequence[str] = ()) -> None:
        super().on_reset(num_envs, names)
        self._names = names

    def on_act(self, actions: NDArray[np.int64], gaps: NDArray[np.float32]) -> None:
        self._actions.append(actions)
        self._gaps.append(gaps)

    def on_step(self, indices: NDArray[np.int64], rewards: NDArray[Any], dones: NDArray[np.bool_]) -> None:
        totals = self._sums + np.where(np.isin(np.arange(len(self._sums)), indices), rewards, 0.0)
        for index in np.flatnonzero(dones).tolist():
            if self._names:
                self._by_name.setdefault(self._names[index], []).append(float(totals[index]))
        super().on_step(indices, rewards, dones)

    def on_held_out(self, score: float, updates: int) -> None:
        self._add_scalar("held out/score", score, updates)

    def __enter__(self) -> ProgressLogger:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._bar.stop()
        if self._writer is not None:
            with contextlib.suppress(OSError):
                self._log()
                self._writer.close()

    def on_phase_start(self, phase: str, done: int, total: int, updates: int = 0) -> None:
        self._total = total
        # Created when there is work to do, so that a refused run leaves no empty curves.
        if total > done and self._writer is None:
            from torch.utils.tensorboard import SummaryWriter

            # Drops the points that an interrupted run logged after its last checkpoint.
            self._writer = SummaryWriter(str(self._folder), purge_step=updates)
        # The lanes step together, so that the last steps may be more than were asked for.
        completed = min(done, total)
        self._phase = self._bar.add_task(phase, total=total, completed=completed, statistics="", visible=total > 0)
        self._logged: tuple[float, int, int] | None = None
        self._refreshed = 0.0

    def on_progress(self, steps: int, updates: int, done: int, epsilon: float | None = None) -> None:
        now = time.monotonic()
        self._pending = steps, updates, epsilon
        if now - self._refreshed < _REFRESH_SECONDS and done < self._total:
            return
        self._refreshed = now
        self._bar.update(self._phase, completed=min(done, self._total), statistics=self._text())
        if self._logged is not None and now - self._logged[0] < _LOG_SECONDS:
            return
        if self._logged is not None:
            seconds = now - self._logged[0]
            self._add_scalar("speed/steps", (steps - self._logged[1]) / seconds, updates)
            self._add_scalar("speed/updates", (updates - self._logged[2]) / seconds, updates)
        self._logged = now, steps, updates
        self._log()

    def _log(self) -> None:
        """Log the pending point of each curve."""
        if self._pending is None:
            return
        (steps, updates, epsilon), self._pending = self._pending, None
        self._add_scalar("progress/steps", steps, updates)
        self._add_scalar("progress/epsilon", epsilon, updates)
        for name, values in (
            ("loss", self._losses),
            ("episode/return", self._returns),
            ("episode/length", self._lengths),
        ):
            self._add_scalar(name, float(np.mean(values)) if values else None, updates)
        for name, totals in self._by_name.items():
            self._add_scalar(f"return/{name}", float(np.mean(totals)), updates)
        if self._actions:
            self._writer.add_histogram("actions", np.concatenate(self._actions), updates)
            self._add_scalar("values/gap", float(np.median(np.concatenate(self._gaps))), updates)
        self._by_name, self._actions, self._gaps = {}, [], []

    def _text(self) -> str:
        parts = [f"loss {np.mean(self._losses):.3g}"] if self._losses else []
        if self._returns:
            parts.append(f"return {np.mean(self._returns):.3g}, length {np.mean(self._lengths):.0f}")
        return "  ".join(parts)

    def _add_scalar(self, name: str, value: float | None, updates: int) -> None:
        # The horizontal axis is updates, which advance in pretraining as well as online.
        if value is not None:
            self._writer.add_scalar(name, value, updates)
