"""Where two traces differ: the part of an observation, and the line that writes a key of info."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from envcraft_checks.comparing.places import located, region, writing_line

from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.target import Target
from envcraft.model.trace import Divergence, Trace

FOUND = Divergence(2, "observation")
FRAME = np.zeros((8, 8, 3), np.uint8)


def _painted() -> Any:
    frame = FRAME.copy()
    frame[2:5, 3] = 9
    frame[4, 6] = 1, 2, 3
    return frame


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        (FRAME, _painted(), " in rows 2 to 4 and columns 3 to 6, first at [2, 3] ([0, 0, 0], then [9, 9, 9])"),
        (np.array([1.0, 2.0]), np.array([1.0, 3.0]), " at [1] (2.0, then 3.0)"),
        (np.array([np.nan, 2.0, 0]), np.array([np.nan, 3.0, 1]), " in 2 of 3 values, first at [1] (2.0, then 3.0)"),
        (np.array(4), np.array(5), " at [] (4, then 5)"),
        (np.array([0.0]), np.array([-0.0]), ""),
    ],
)
def test_the_part_of_an_observation_that_differs(first: Any, second: Any, words: str) -> None:
    assert str(region(FOUND, first, second)) == f"observation differs at step 2{words}"


class Played:
    """A subject whose frames differ at step 2 under a condition, and that affords some steps."""

    def __init__(self, frames: bool, steps: int = 100) -> None:
        self._frames, self._steps = frames, steps

    def affords(self, steps: int) -> bool:
        return steps <= self._steps

    def rerun(self, rollout: Rollout) -> Trace:
        assert (len(rollout.actions), rollout.keep) == (2, 3)
        last = _painted() if rollout.conditions.fresh else FRAME
        digests = [b"a", b"b", last.tobytes()]
        frames = [FRAME, FRAME, last] if self._frames else []
        flags: Any = [False, False]
        return Trace(rollout, digests, [b"{}"] * 3, [0.0, 0.0], [], flags, flags, frames=frames)


@pytest.mark.parametrize(
    ("found", "subject", "place"),
    [
        (FOUND, Played(frames=True), "in rows 2 to 4 and columns 3 to 6, first at [2, 3]"),
        (FOUND, Played(frames=False), ""),
        (FOUND, Played(frames=True, steps=1), ""),
        (Divergence(2, "reward", 0.0, 1.0), Played(frames=True), ""),
        (Divergence(1, "observation"), SimpleNamespace(affords=lambda steps: False), ""),
    ],
)
def test_both_episodes_run_again_for_their_frames(found: Divergence, subject: Any, place: str) -> None:
    assert located(subject, Rollout(0, [[0], [0], [0]]), Conditions(fresh=True), found).where == place


@pytest.mark.parametrize(
    ("source", "line"),
    [
        ("x = 1\ninfo = {'at': 1}\n", 2),
        ("info = {}\ninfo['at'] = 1\nprint(info['at'])\n", 2),
        ("info = dict(\n  at=1)\n", 2),
        ("info = {'at': 1}\ninfo['at'] = 2\n", None),
        ("info = {name: 1}\n", None),
    ],
)
def test_the_only_line_that_writes_a_key_of_info(source: str, line: int | None) -> None:
    subject: Any = SimpleNamespace(target=Target("game.py"), text=source)
    assert writing_line(subject, Divergence(1, "info", {"at.now": 1}, {"at.now": 2})) == line
    assert writing_line(subject, Divergence(1, "reward", 1.0, 2.0)) is None
    assert writing_line(subject, Divergence(1, "info")) is None
