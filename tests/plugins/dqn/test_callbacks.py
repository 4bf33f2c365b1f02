"""Curves of an interrupted run equal those of an uninterrupted one."""

from __future__ import annotations

import io
import os
from pathlib import Path

import pytest
from envcraft_dqn.callbacks import ProgressLogger
from envcraft_dqn.study.curve import LearningCurve, read
from rich.console import Console


def points(folder: Path, name: str) -> list[tuple[int, float]]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder))
    events.Reload()
    return [(one.step, one.value) for one in events.Scalars(name)]


def test_curves_resume_from_the_checkpoint(tmp_path: Path) -> None:
    for first, end in ((0, 50), (20, 60)):
        with ProgressLogger(tmp_path) as callback:
            callback.on_phase_start("pretraining", 0, 0, first)
            callback.on_phase_start("training", 4 * first, 240, first)
            for update in range(first + 1, end + 1):
                callback.on_update(1.0)
                callback.on_progress(4 * update, update, 4 * update)
    # The last point of the first run is after the checkpoint, and is dropped.
    assert points(tmp_path, "progress/steps") == [(1, 4.0), (21, 84.0), (60, 240.0)]


@pytest.mark.parametrize("width", [50, 60, 80, 120])
def test_a_narrow_terminal_shows_the_total(width: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    logger = ProgressLogger(tmp_path)
    logger.on_phase_start("training", 3239, 3239)
    logger._bar.update(logger._phase, total=1_000_000, statistics="loss 0.0123  return -0.123, length 1000")
    shown = io.StringIO()
    Console(file=shown, width=width).print(logger._bar.get_renderable())
    words = shown.getvalue().split()
    assert {"training", "3239/1000000", "0.0123", "-0.123,", "1000"} <= set(words)
    assert (len(shown.getvalue().splitlines()) == 1) is (width >= 80)


def test_progress_ends_at_its_total(tmp_path: Path) -> None:
    """The same for a run that went beyond it and is started again."""
    for done in (0, 304):
        with ProgressLogger(tmp_path) as logger:
            logger.on_phase_start("training", done, 300)
            if not done:
                logger.on_progress(303, 1, 303)
        shown = io.StringIO()
        Console(file=shown, width=120).print(logger._bar.get_renderable())
        assert "300/300" in shown.getvalue()


def test_interrupted_write_keeps_the_curve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "curve.jsonl"
    curve = LearningCurve(file)
    curve.on_phase_start("training", 0, 10)
    curve.on_progress(1, 1, 1)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        curve.on_progress(2, 2, 2)
    assert [point["done"] for point in read(file)] == [1]
