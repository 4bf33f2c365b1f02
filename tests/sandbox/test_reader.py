"""Whatever bytes come from a job, reading them ends in a trace or in Forged, and costs no more than it should."""

from __future__ import annotations

import contextlib
import json
import sys
from typing import Any

import pytest
from envcraft_sandbox.reader import Forged, Reader
from envcraft_sandbox.wire import HEADER, STEP, VALUE, Kind
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from envcraft.contract import ARCADE
from envcraft.rollout import Rollout
from envcraft.trace import Recording, diverge

FLOAT = {"k": "float"}


def message(kind: int, payload: bytes | Any = b"") -> bytes:
    data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    return HEADER.pack(kind, len(data)) + data


def step(
    kind: Kind, *, layout: int = 0, observation: bytes = bytes(8), info: bytes = b"", reward: float = 1.0
) -> bytes:
    return message(kind, STEP.pack(0, 0, 0, 4, reward, 7, layout, len(observation), len(info)) + observation + info)


def recording(steps: int = 8) -> Recording:
    return Recording(Rollout(0, [[0, 0, 0]] * steps), ARCADE.observation, ARCADE.action)


GOOD = [
    message(Kind.PHASE, "reset"),
    message(Kind.LAYOUT, FLOAT),
    message(Kind.LAYOUT, {"k": "dict", "items": [["a", {"k": "array", "dtype": "<U3", "shape": [2]}], ["b", FLOAT]]}),
    step(Kind.RESET, info=b'{"a": [1, 2]}'),
    step(Kind.STEP),
    message(Kind.RENDER, VALUE.pack(0) + bytes(8)),
    step(Kind.STEP, layout=1, observation=bytes(32)),
    message(Kind.ACTED, {"before": [0, 0, 0], "now": [0, 0, 0]}),
    message(Kind.FAULT, {"phase": "step", "type": "ValueError", "message": "no", "line": 3}),
    message(Kind.RESULT, {"steps": 3}),
    message(Kind.TICK),
    message(Kind.END, {}),
]

JSON: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["k", "items", "dtype", "shape", "n", "type", "phase", "line"]), inner, max_size=4
        )
    ),
    max_leaves=12,
)
MESSAGES = (
    st.sampled_from(GOOD)
    | st.builds(message, st.integers(0, 255), st.binary(max_size=60))
    | st.builds(message, st.sampled_from(list(Kind)), JSON)
    | st.binary(max_size=20)
)


def test_the_good_stream_is_read() -> None:
    reader, made = Reader(recording()), b"".join(GOOD)
    for position in range(len(made)):
        reader.feed(made[position : position + 1])
    assert reader.ended


@settings(max_examples=600, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(MESSAGES, max_size=12), st.integers(1, 400))
def test_any_stream_is_read_or_forged(parts: list[bytes], size: int) -> None:
    reader, stream = Reader(recording()), b"".join([*GOOD[: size % 5], *parts])
    with contextlib.suppress(Forged):
        for start in range(0, len(stream), size):
            reader.feed(stream[start : start + size])


@pytest.mark.parametrize("kind", [kind for kind in Kind if kind not in (Kind.LOADED, Kind.RESULT)])
def test_no_json_is_long(kind: Kind) -> None:
    with pytest.raises(Forged):
        Reader(recording()).feed(HEADER.pack(kind, 9 * 1024 * 1024))


def test_layouts_are_bounded_in_all() -> None:
    reader = Reader(recording())
    many = message(Kind.LAYOUT, {"k": "list", "items": [FLOAT] * 4000})
    with pytest.raises(Forged, match="parts"):
        reader.feed(many * 100)


def test_an_end_before_the_episodes_is_forged() -> None:
    begun = b"".join([GOOD[1], step(Kind.RESET), step(Kind.STEP)])
    for stream in (b"", begun):
        with pytest.raises(Forged, match="an end after"):
            Reader(recording()).feed(stream + message(Kind.END, {}))
    whole = Reader(recording(1))
    whole.feed(begun + message(Kind.END, {}))
    assert whole.ended


def long_infos(steps: int, odd: int = -1) -> Recording:
    made = recording(steps)
    reader = Reader(made)
    reader.feed(message(Kind.LAYOUT, FLOAT) + step(Kind.RESET))
    for number in range(steps):
        info = {"number": number + (number == odd), "text": "x" * 60_000}
        reader.feed(step(Kind.STEP, info=json.dumps(info).encode()))
    return made


def test_long_infos_are_not_kept() -> None:
    trace = long_infos(100).trace
    assert sum(map(sys.getsizeof, trace.infos)) < 1024**2
    assert trace.info()["number"] == 99
    assert trace.info(1)["number"] == 0
    assert trace.info(50) == {}


@pytest.mark.parametrize("odd", [2, 50, 99])
def test_long_infos_are_still_compared(odd: int) -> None:
    one, two = long_infos(100).trace, long_infos(100, odd).trace
    found = diverge(one, two)
    assert found is not None
    assert (found.step, found.field) == (odd + 1, "info")
    assert diverge(one, long_infos(100).trace) is None


def test_a_trace_that_stops_is_compared_with_one_that_goes_on() -> None:
    found = diverge(long_infos(100).trace, long_infos(60).trace)
    assert found is not None
    assert (found.step, found.field) == (61, "length")
