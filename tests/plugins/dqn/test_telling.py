"""The curves of a run, which are those of one that nothing interrupted."""

from __future__ import annotations

from pathlib import Path

import pytest
from envcraft_dqn.study.curve import Curve, read
from envcraft_dqn.telling import Shown


def points(folder: Path, name: str) -> list[tuple[int, float]]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    found = EventAccumulator(str(folder))
    found.Reload()
    return [(one.step, one.value) for one in found.Scalars(name)]


def test_curves_go_on_from_the_checkpoint_to_the_last_step(tmp_path: Path) -> None:
    for begun, end in ((0, 50), (20, 60)):
        with Shown(tmp_path) as teller:
            teller.begin("pretraining", 0, 0, begun)
            teller.begin("training", 4 * begun, 240, begun)
            for update in range(begun + 1, end + 1):
                teller.updated(1.0)
                teller.progress(4 * update, update, 4 * update)
    # The first run's last point came after the checkpoint.
    assert points(tmp_path, "progress/steps") == [(1, 4.0), (21, 84.0), (60, 240.0)]


def test_a_curve_that_is_killed_while_it_is_written_keeps_its_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "curve.jsonl"
    curve = Curve(file)
    curve.begin("training", 0, 10)
    curve.progress(1, 1, 1)

    def cut_off(path: Path, *_: object) -> None:
        path.open("w").close()
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_text", cut_off)
    with pytest.raises(KeyboardInterrupt):
        curve.progress(2, 2, 2)
    assert [point["done"] for point in read(file)] == [1]
