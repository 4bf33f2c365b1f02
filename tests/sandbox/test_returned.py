"""Which observations are held, and which changes are noticed, by who else refers to their memory."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from envcraft_sandbox.worker.channel import encode_value
from envcraft_sandbox.worker.returned import Returned


class Seen:
    """A channel that keeps the numbers of the observations that changed."""

    def __init__(self) -> None:
        self.number, self.sent = -1, (0, b"", 0)
        self.changed: list[int] = []

    def read(self, observation: Any) -> Any:
        return 0, encode_value(observation)[1], 0

    def is_resized(self, observation: Any) -> bool:
        return False

    def send_json(self, kind: int, value: Any) -> None:
        self.changed.append(value["at"])


class Env:
    """Returns frames as `draw` says, given the step and the environment, which may keep any attribute."""

    def __init__(self, draw: Any) -> None:
        self._draw = draw

    def step(self, number: int) -> Any:
        return self._draw(self, number)


def played(draw: Any, steps: int, everything: bool) -> tuple[list[int], int]:
    """The numbers of the observations that changed, and how many were held at the end."""
    channel: Any = Seen()
    subject: Any = SimpleNamespace(channel=channel, call=lambda phase, function, *args: function(*args))
    returned, env = Returned(subject, everything), Env(draw)
    for number in range(steps):
        observation = env.step(number)
        channel.number, channel.sent = number, channel.read(observation)
        returned.add(observation)
        del observation
    held = len(returned._kept)
    returned.check()
    return channel.changed, held


def _fresh(env: Env, number: int) -> Any:
    return np.full((9, 9), number)


def _view(env: Env, number: int) -> Any:
    return np.full((9, 9), number).T


def _kept(env: Env, number: int) -> Any:
    vars(env)["frame"] = np.full((9, 9), number)
    return env.frame  # type: ignore[attr-defined]


def _constant(env: Env, number: int) -> Any:
    vars(env).setdefault("frame", np.zeros(9))
    return env.frame[:]  # type: ignore[attr-defined]


def _slices(env: Env, number: int) -> Any:
    history = vars(env).setdefault("history", np.zeros((99, 9)))
    history[number] = number
    return history[number]


def _many(env: Env, number: int) -> Any:
    return vars(env).setdefault(str(number), np.zeros(1))


def _ring(env: Env, number: int) -> Any:
    buffers = vars(env).setdefault("buffers", [np.zeros(9) for _ in range(40)])
    buffers[number % 40][:] = number
    return buffers[number % 40]


def _ring_of_slices(env: Env, number: int) -> Any:
    buffer = vars(env).setdefault("buffer", np.zeros((40, 9)))
    buffer[number % 40] = number
    return buffer[number % 40]


def _view_of_one(env: Env, number: int) -> Any:
    canvas = vars(env).setdefault("canvas", np.zeros((9, 9)))
    canvas[number % 9] = number + 1
    return canvas.T


def _late(env: Env, number: int) -> Any:
    if number == 7:
        env.frame[:] = 0  # type: ignore[attr-defined]
    vars(env)["frame"] = np.full(9, number)
    return env.frame  # type: ignore[attr-defined]


def _all_late(env: Env, number: int) -> Any:
    frames = vars(env).setdefault("frames", [])
    frames.append({"picture": np.full(9, number)})
    if number == 19:
        frames[3]["picture"][:] = 0
    return frames[-1]


@pytest.mark.parametrize("everything", [False, True])
@pytest.mark.parametrize("draw", [_fresh, _view, _kept, _constant, _slices])
def test_what_stays_as_it_was_is_no_change(draw: Any, everything: bool) -> None:
    assert played(draw, 60, everything)[0] == []


@pytest.mark.parametrize("everything", [False, True])
@pytest.mark.parametrize(
    ("draw", "changed"), [(_view_of_one, [0, 1, 2]), (_ring, [0, 1, 2]), (_ring_of_slices, [0, 1, 2]), (_late, [6])]
)
def test_what_the_environment_writes_into_is_a_change(draw: Any, changed: list[int], everything: bool) -> None:
    assert played(draw, 60, everything)[0] == changed


def test_values_inside_others_are_watched_where_everything_is() -> None:
    assert played(_all_late, 20, True)[0] == [3]


@pytest.mark.parametrize(("draw", "held"), [(_fresh, 0), (_view, 0), (_kept, 1), (_ring, 40), (_constant, 1)])
def test_nothing_is_held_that_the_environment_does_not_hold(draw: Any, held: int) -> None:
    assert played(draw, 40, False)[1] == held


def test_the_memory_of_what_is_held_is_bounded() -> None:
    assert played(lambda env, number: np.zeros(2**20) + number, 40, True)[1] == 8
    assert played(_many, 99, False)[1] == 64
