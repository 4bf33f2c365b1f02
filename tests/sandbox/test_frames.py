"""Frames that travel as digests: which ones, how they are read, and that the order in memory makes no difference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xxhash
from envcraft_protocol.adapters import resized
from envcraft_protocol.wire import MAX_OBSERVATION
from envcraft_sandbox.worker.frames import Frames, digest
from numpy.typing import NDArray

from envcraft.contracts.builtin import ARCADE_NATIVE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.selection import driver_named
from envcraft.judging.subject import Subject
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.target import Target
from envcraft.model.trace import diverge
from envcraft.spaces.codec import ValueCodec
from envcraft.spaces.spec import read_space

NATIVE: Any = {"contract": ARCADE_NATIVE.for_worker(), "frame": [84, 84, 3]}
EXACT: Any = {"contract": {}, "frame": [84, 84, 3]}


def drawn(*shape: int) -> NDArray[np.uint8]:
    return np.random.default_rng(sum(shape)).integers(0, 256, shape, dtype=np.uint8)


def columns_first(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An equal frame whose columns of pixels lie one after the other, as those of pygame do."""
    return np.ascontiguousarray(frame.transpose(1, 0, 2)).transpose(1, 0, 2)


@pytest.mark.parametrize(
    ("job", "value", "expected"),
    [
        (EXACT, drawn(84, 84, 3), True),
        (EXACT, drawn(84, 85, 3), False),
        (EXACT, drawn(84, 84, 3).astype(np.int16), False),
        (EXACT, drawn(84, 84, 3).tolist(), False),
        (EXACT, None, False),
        ({}, drawn(84, 84, 3), False),
        (NATIVE, drawn(84, 84, 3), True),
        (NATIVE, drawn(400, 640, 3), True),
        (NATIVE, drawn(400, 640, 4), False),
        (NATIVE, drawn(400, 640), False),
        (NATIVE, drawn(5, 5, 3), False),
        (NATIVE, np.zeros((1, MAX_OBSERVATION // 3 + 1, 3), np.uint8), False),
        ({"contract": ARCADE_NATIVE.for_worker()}, drawn(400, 640, 3), False),
    ],
)
def test_only_frames_that_need_no_look_are_digested(job: Any, value: Any, expected: bool) -> None:
    assert (Frames(job).layout(value) is not None) is expected


@pytest.mark.parametrize(
    ("space", "resize", "frame"),
    [
        ({"shape": [84, 84, 3]}, None, (84, 84, 3)),
        ({"shape": [84, 84, 3]}, (84, 84), (84, 84, 3)),
        ({"shape": [64, 64, 3]}, (84, 84), None),
        ({"shape": [84, 84, 3], "high": 254}, None, None),
        ({"shape": [84, 84, 3], "dtype": "int16"}, None, None),
    ],
)
def test_the_space_says_which(space: dict[str, Any], resize: tuple[int, int] | None, frame: Any) -> None:
    read = read_space({"type": "Box", "low": 0, "high": 255, "dtype": "uint8", **space})
    assert TraceBuilder(Rollout(0, []), read, None, resize=resize).frame == frame


@pytest.mark.parametrize("shape", [(84, 84, 3), (400, 640, 3)])
def test_a_digest_is_that_of_the_host(shape: tuple[int, int, int]) -> None:
    frame = drawn(*shape)
    described = Frames(NATIVE).layout(frame)
    assert described is not None
    layout = ValueCodec({"k": "array", "dtype": "|u1", "shape": list(shape)})
    assert digest(frame, *described[1:]) == xxhash.xxh3_128_digest(frame.tobytes(), layout.tag)


@pytest.mark.parametrize("shape", [(84, 84, 3), (400, 640, 3), (300, 300, 3)])
@pytest.mark.parametrize("first", ["rows", "columns"])
def test_equal_frames_have_equal_digests_in_any_order(shape: tuple[int, int, int], first: str) -> None:
    frame = drawn(*shape)
    equal = [frame, columns_first(frame), np.flip(np.flip(frame, 1).copy(), 1), np.asfortranarray(frame)]
    frames = Frames(NATIVE)
    described: Any = None
    digests = set()
    for value in equal if first == "rows" else [equal[1], *equal]:
        described = frames.layout(value)
        assert described is not None
        assert described[0].get("columns") is (first == "columns" if frame.nbytes > 65536 else None)
        digests.add(digest(value, *described[1:]))
    assert len(digests) == 1
    changed = columns_first(frame)
    changed[-1, -1, -1] ^= 1
    assert digest(changed, *described[1:]) not in digests


def test_a_picture_is_what_an_agent_sees() -> None:
    frame = columns_first(drawn(400, 640, 3))
    frames = Frames(NATIVE | {"pictures": {"first": 2, "every": 4, "until": 9}})
    shown = [number for number in range(20) if frames.picture(frame, number)]
    assert shown == [0, 1, 4, 8]
    assert frames.picture(frame, 0) == resized(frame, 84, 84).tobytes()


GAME = """
import os
import gymnasium as gym
import numpy as np

class Game(gym.Env):
    observation_space = gym.spaces.Box(0, 255, (200, 300, 3), np.uint8)
    action_space = gym.spaces.MultiDiscrete([5, 2, 2])

    def _frame(self):
        frame = np.full((200, 300, 3), self.t % 250, np.uint8)
        frame[:, : 10 * self.x % 300] = 7
        if {turned}:
            return frame.transpose(1, 0, 2).copy().transpose(1, 0, 2)
        return frame

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.x = 0, int(self.np_random.integers(30))
        return self._frame(), {{}}

    def step(self, action):
        self.t += 1
        self.x += int(action[0])
        return self._frame(), 0.0, False, self.t >= 30, {{}}

    def render(self):
        return self._frame().copy()
"""
#: In one process so, in the other so.
ORDERS = {"rows": "False", "columns": "True", "some": "os.getpid() % 2", "in turns": "self.t % 2"}


@pytest.mark.parametrize("turned", ORDERS.values(), ids=ORDERS)
def test_the_order_in_memory_is_no_difference(turned: str) -> None:
    rollout = Rollout(3, [[number % 5, 0, 0] for number in range(30)])
    pool = WorkerPool(driver_named("process"))
    source = GAME.format(turned=turned).encode()
    with Subject(Target("game.py", source), ARCADE_NATIVE, pool.lease(), BUDGETS["quick"]) as subject:
        first = subject.rollout(rollout, alone=True)
        for trace in (subject.rerun(rollout), subject.rerun(rollout), subject.rerun(rollout)):
            assert diverge(first, trace) is None
        rendered = subject.rollout(rollout.under(Conditions(render=True, reread=True)))
    assert len(set(first.observations)) > 20
    assert (rendered.renders, rendered.render_problems, rendered.overwritten) == (31, [], [])
    assert first.columns is rendered.columns


def test_frames_are_kept_as_an_agent_sees_them() -> None:
    rollout = Rollout(3, [[1, 0, 0]] * 30)
    pool = WorkerPool(driver_named("process"))
    source = GAME.format(turned="True").encode()
    with Subject(Target("game.py", source), ARCADE_NATIVE, pool.lease(), BUDGETS["quick"]) as subject:
        plain = subject.rollout(rollout)
        kept = subject.rerun(Rollout(3, [[1, 0, 0]] * 30, keep=5))
    assert plain.frames == []
    assert [frame.shape for frame in kept.frames] == [(84, 84, 3)] * 5
    assert kept.observations == plain.observations
