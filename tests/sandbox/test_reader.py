"""Whatever bytes come from a job, reading them ends in a trace or in Forged, and costs no more than it should."""

from __future__ import annotations

import contextlib
import json
import socket
import sys
from typing import Any

import numpy as np
import pytest
from envcraft_protocol.jobs import Job
from envcraft_protocol.wire import (
    BLOCK,
    DIGEST,
    FRAME,
    HEADER,
    LONG,
    MAX_STEPS,
    RENDERED,
    RESOURCES,
    SAME,
    SAME_INFO,
    STEP,
    VALUE,
    Kind,
)
from envcraft_sandbox.reader import Forged, Reader
from envcraft_sandbox.worker.channel import Channel
from envcraft_sandbox.worker.frames import Frames
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.model.rollout import Conditions, Episode, Rollout
from envcraft.model.trace import Resources, StateChange, diverge
from envcraft.spaces.spec import read_space

FLOAT = {"k": "float"}
PICTURE = {"k": "array", "dtype": "|u1", "shape": [84, 84, 3]}
FRAMES = PICTURE | {"k": "frame"}


def message(kind: int, payload: bytes | Any = b"") -> bytes:
    data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    return HEADER.pack(kind, len(data)) + data


def step(
    kind: Kind,
    *,
    layout: int = 0,
    observation: bytes = bytes(8),
    info: bytes = b"",
    reward: float = 1.0,
    flags: int = 0,
) -> bytes:
    return block([record(flags, reward, layout, len(observation), len(info))], observation + info, kind=kind)


def record(
    flags: int = 0, reward: float = 1.0, layout: int = 0, size: int = 8, info: int = 0, *, kind: int = 4
) -> bytes:
    return STEP.pack(flags, 0, 0, kind, reward, 7, layout, size, info)


def block(
    records: list[bytes],
    values: bytes = b"",
    actions: bytes = b"",
    *,
    kind: Kind = Kind.STEPS,
    count: int | None = None,
) -> bytes:
    head = BLOCK.pack(len(records) if count is None else count, len(actions))
    return message(kind, head + b"".join(records) + values + actions)


def recording(steps: int = 8) -> TraceBuilder:
    return TraceBuilder(Rollout(0, [[0, 0, 0]] * steps), read_space(ARCADE.observation), read_space(ARCADE.action))


GOOD = [
    message(Kind.PHASE, "reset"),
    message(Kind.LAYOUT, FLOAT),
    message(Kind.LAYOUT, {"k": "dict", "items": [["a", {"k": "array", "dtype": "<U3", "shape": [2]}], ["b", FLOAT]]}),
    step(Kind.RESET, info=b'{"a": [1, 2]}'),
    step(Kind.STEPS),
    message(Kind.RENDER, VALUE.pack(0, 0) + bytes(8)),
    step(Kind.STEPS, layout=1, observation=bytes(32)),
    message(Kind.ACTED, {"before": [0, 0, 0], "now": [0, 0, 0]}),
    message(Kind.CHANGED, {"at": 1}),
    message(Kind.SPACE, {"name": "action_space", "before": "Discrete(3)", "now": "Discrete(2)"}),
    message(Kind.FAULT, {"phase": "step", "type": "ValueError", "message": "no", "line": 3}),
    message(Kind.RESULT, {"steps": 3}),
    message(Kind.TICK),
    message(Kind.LAYOUT, {"k": "array", "dtype": "|u1", "shape": [LONG]}),
    step(Kind.STEPS, layout=2, observation=bytes(LONG)),
    step(Kind.STEPS, layout=2, observation=b"", flags=SAME),
    block([record(SAME | SAME_INFO, layout=2, size=0)] * 2),
    message(Kind.LAYOUT, {"k": "frame", "dtype": "|u1", "shape": [84, 84, 3]}),
    block([record(FRAME | SAME_INFO, layout=3, size=DIGEST)], bytes(DIGEST)),
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


def test_the_end_has_counts() -> None:
    reader = Reader(recording())
    reader.feed(b"".join(GOOD[:-1]) + message(Kind.END, {"steps": 7, "waits": 3}))
    assert reader.ended
    assert (reader.steps, reader.waits) == (7, 3)


@pytest.mark.parametrize("name", ["steps", "waits"])
@pytest.mark.parametrize("count", [-1, 2**32, 10**400, True, 1.5, "1", None])
def test_counts_that_cannot_be_are_forged(name: str, count: Any) -> None:
    with pytest.raises(Forged, match=name):
        Reader(recording()).feed(b"".join(GOOD[:-1]) + message(Kind.END, {name: count}))


def test_the_end_says_which_marks_were_reached() -> None:
    for marks, end, reached in ((3, {"reached": "010"}, "010"), (3, {}, ""), (0, {}, "")):
        reader = Reader(recording(), marks=marks)
        reader.feed(b"".join(GOOD[:-1]) + message(Kind.END, end))
        assert (reader.ended, reader.reached) == (True, reached)


@pytest.mark.parametrize(
    "reached", ["0", "01", "0101", "01x", "01\n", 10, None, ["0", "1", "0"], {"0": 1, "1": 1, "2": 1}, True]
)
def test_marks_that_the_source_does_not_have_are_forged(reached: Any) -> None:
    with pytest.raises(Forged, match="marks"):
        Reader(recording(), marks=3).feed(b"".join(GOOD[:-1]) + message(Kind.END, {"reached": reached}))


def test_marks_that_nobody_made_are_forged() -> None:
    with pytest.raises(Forged, match="marks"):
        Reader(recording()).feed(b"".join(GOOD[:-1]) + message(Kind.END, {"reached": "1"}))


def test_an_end_that_is_no_object_is_forged() -> None:
    with pytest.raises(Forged, match="END"):
        Reader(recording()).feed(b"".join(GOOD[:-1]) + message(Kind.END, []))


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


FIELD = ["self.speed", "0" * 32, "0.25"]


def stated(*states: Any, steps: int = 1) -> TraceBuilder:
    rollout = Rollout(0, [[0, 0, 0]] * steps, fields=True)
    builder = TraceBuilder(rollout, read_space(ARCADE.observation), read_space(ARCADE.action))
    parts = [message(Kind.LAYOUT, FLOAT), step(Kind.RESET), message(Kind.FIELDS, states[0])]
    for state in states[1:]:
        parts += [step(Kind.STEPS), message(Kind.FIELDS, state)]
    Reader(builder).feed(b"".join(parts))
    return builder


def fields(changed: Any = (), gone: Any = (), lines: Any = ()) -> dict[str, Any]:
    return {"changed": changed, "gone": gone, "lines": lines}


def test_the_fields_of_each_state_are_kept() -> None:
    states = stated(fields([FIELD], lines=[3, 4]), fields(gone=["self.speed"])).trace.states
    assert states[0] == StateChange({"self.speed": ("0" * 32, "0.25")}, (), frozenset({3, 4}))
    assert states[1] == StateChange({}, ("self.speed",), frozenset())


@pytest.mark.parametrize(
    "state",
    [
        {},
        fields(1),
        fields([["self.speed", "0" * 32]]),
        fields([["self.speed", "0" * 31, ""]]),
        fields([["self.speed", "0" * 32 + "\n", ""]]),
        fields([["", "0" * 32, ""]]),
        fields([["x" * 201, "0" * 32, ""]]),
        fields([["self.speed", "0" * 32, "x" * 401]]),
        fields([["self.\x1b[31m", "0" * 32, ""]]),
        fields([["self.speed", "0" * 32, "1\n2"]]),
        fields([["self.speed", "0" * 32, 5]]),
        fields([FIELD] * 1001),
        fields(gone=["a"] * 1001),
        fields(gone=["x" * 201]),
        fields(gone=[None]),
        fields(lines=[-1]),
        fields(lines=[2**31]),
        fields(lines=[1.5]),
        fields(lines=[1] * 2001),
    ],
)
def test_fields_that_the_worker_would_not_send_are_forged(state: Any) -> None:
    with pytest.raises(Forged):
        stated(state)


def test_fields_belong_to_a_state() -> None:
    one = message(Kind.FIELDS, fields([FIELD]))
    builder = TraceBuilder(Rollout(0, [[0, 0, 0]], fields=True), read_space(ARCADE.observation), None)
    for parts in ([one], [message(Kind.LAYOUT, FLOAT), step(Kind.RESET), one, one]):
        builder.restart()
        with pytest.raises(Forged, match="not requested"):
            Reader(builder).feed(b"".join(parts))
    with pytest.raises(Forged, match="not requested"):
        Reader(recording()).feed(b"".join([message(Kind.LAYOUT, FLOAT), step(Kind.RESET), one]))


def test_the_fields_of_an_episode_are_bounded() -> None:
    many = [[f"{'x' * 190} {number}", "0" * 32, "y" * 400] for number in range(1000)]
    with pytest.raises(Forged, match="bytes"):
        stated(*[fields(many)] * 8, steps=8)


def test_earlier_episodes_have_no_fields() -> None:
    with pytest.raises(Forged, match="not requested"):
        recorded(*FIRST, message(Kind.FIELDS, fields([FIELD])))


USED = message(Kind.RESOURCES, RESOURCES.pack(*range(1, 10)))
FIRST = [message(Kind.PHASE, "before"), message(Kind.LAYOUT, FLOAT), step(Kind.RESET), step(Kind.STEPS)]
LAST = [message(Kind.PHASE, "reset"), step(Kind.RESET), step(Kind.STEPS)]


def recorded(*messages: bytes) -> TraceBuilder:
    before = [Episode(5, [[0, 0, 0]] * 2), Episode(6, [])]
    rollout = Rollout(0, [[0, 0, 0]], Conditions(before=before, recorded=True))
    builder = TraceBuilder(rollout, read_space(ARCADE.observation), read_space(ARCADE.action))
    Reader(builder).feed(b"".join(messages))
    return builder


@pytest.mark.parametrize("earlier", [0, 1, 2])
def test_earlier_episodes_are_recorded_as_far_as_time_allows(earlier: int) -> None:
    parts = [FIRST[0], FIRST[1], *[*FIRST[2:], USED][: 3 * earlier], *[FIRST[2], USED][: 2 * (earlier - 1)]]
    trace = recorded(*parts, *LAST, message(Kind.END, {})).main
    assert (trace.rollout.seed, trace.steps) == (0, 1)
    assert [(episode.rollout.seed, episode.steps) for episode in trace.before] == [(5, 1), (6, 0)][:earlier]
    assert all(used.resources == Resources(*range(1, 10)) for used in trace.before)


def test_a_fault_in_an_earlier_episode_is_one_of_the_rollout() -> None:
    fault = message(Kind.FAULT, {"phase": "before", "type": "ValueError"})
    trace = recorded(*FIRST, fault, message(Kind.END, {})).main
    assert (trace.rollout.seed, trace.usable, len(trace.before)) == (0, False, 1)
    assert trace.fault is not None


@pytest.mark.parametrize(
    "messages",
    [
        [USED],
        [*FIRST, USED, USED],
        [*FIRST, *LAST, USED],
        [*FIRST, message(Kind.RESOURCES, bytes(3))],
        [*FIRST, *FIRST[3:], *FIRST[3:]],
        [*FIRST, FIRST[2], FIRST[2]],
        [*FIRST, *LAST, FIRST[0], FIRST[2]],
        [*FIRST, *LAST, LAST[1]],
        [*FIRST, message(Kind.END, {})],
    ],
)
def test_recorded_episodes_that_cannot_be_are_forged(messages: list[bytes]) -> None:
    with pytest.raises(Forged):
        recorded(*messages)


def test_measurements_belong_to_recorded_episodes() -> None:
    for messages in ([step(Kind.RESET), USED], [message(Kind.PHASE, "before"), step(Kind.RESET), step(Kind.RESET)]):
        with pytest.raises(Forged):
            Reader(recording()).feed(b"".join([message(Kind.LAYOUT, FLOAT), *messages]))


def test_layouts_are_bounded_in_all() -> None:
    reader = Reader(recording())
    many = message(Kind.LAYOUT, {"k": "list", "items": [FLOAT] * 4000})
    with pytest.raises(Forged, match="parts"):
        reader.feed(many * 100)


def test_an_end_before_the_episodes_is_forged() -> None:
    prefix = b"".join([GOOD[1], step(Kind.RESET), step(Kind.STEPS)])
    for stream in (b"", prefix):
        with pytest.raises(Forged, match="an end after"):
            Reader(recording()).feed(stream + message(Kind.END, {}))
    whole = Reader(recording(1))
    whole.feed(prefix + message(Kind.END, {}))
    assert whole.ended


def frames(*messages: bytes) -> TraceBuilder:
    made = recording()
    Reader(made).feed(message(Kind.LAYOUT, PICTURE) + message(Kind.LAYOUT, FLOAT) + b"".join(messages))
    return made


def again(kind: Kind = Kind.STEPS, layout: int = 0) -> bytes:
    return step(kind, layout=layout, observation=b"", flags=SAME)


def test_a_value_that_comes_again_is_as_if_it_had_been_sent() -> None:
    one, two = (bytes([number]) * 84 * 84 * 3 for number in range(2))
    short = step(Kind.STEPS, layout=1)
    whole = frames(
        *(step(Kind.RESET if not n else Kind.STEPS, observation=f) for n, f in enumerate((one, one, two, two)))
    )
    repeated = frames(step(Kind.RESET, observation=one), again(), step(Kind.STEPS, observation=two), again())
    assert repeated.trace.observations == whole.trace.observations
    between = frames(step(Kind.RESET, observation=one), short, again())
    assert between.trace.observations[2] == between.trace.observations[0]
    drawn = frames(step(Kind.RESET, observation=one), message(Kind.RENDER, VALUE.pack(SAME, 0)))
    assert (drawn.trace.renders, drawn.trace.render_problems) == (1, [])


def run(steps: int = 3, *, flags: int = SAME | SAME_INFO, layout: int = 0, size: int = 0, kind: int = 4) -> bytes:
    return block([record(flags, 0.5, layout, size, kind=kind)] * steps)


BLACK = bytes(84 * 84 * 3)


@pytest.mark.parametrize(
    "messages",
    [
        [again(Kind.RESET)],
        [step(Kind.RESET, layout=1), again(layout=1)],
        [step(Kind.RESET, observation=BLACK), again(layout=1)],
        [step(Kind.RESET, observation=BLACK), step(Kind.STEPS, observation=bytes(LONG), flags=SAME)],
        [step(Kind.RESET, observation=BLACK), message(Kind.RENDER, VALUE.pack(1, 0))],
    ],
    ids=["nothing", "short", "layout", "bytes", "flags"],
)
def test_a_value_that_cannot_come_again_is_forged(messages: list[bytes]) -> None:
    with pytest.raises(Forged):
        frames(*messages)


@pytest.mark.parametrize(
    "messages",
    [
        [run()],
        [step(Kind.RESET, layout=1), run()],
        *([step(Kind.RESET, observation=BLACK), made] for made in (run(9), run(0), run(layout=1), run(size=1))),
        *([step(Kind.RESET, observation=BLACK), made] for made in (run(flags=255), run(kind=99))),
        [step(Kind.RESET, observation=BLACK), message(Kind.STEPS, bytes(5))],
        [step(Kind.RESET, observation=BLACK), block([record(SAME, size=0)], count=2)],
        [step(Kind.RESET, observation=BLACK), block([record(SAME, size=0)], count=0)],
        [step(Kind.RESET, observation=BLACK), block([record(SAME, size=0)], b"x")],
        [step(Kind.RESET, observation=BLACK), block([record(SAME, size=0)], actions=b"{}")],
        [step(Kind.RESET, observation=BLACK), block([record(SAME, size=0)], actions=b"[1]")],
        [step(Kind.RESET, observation=BLACK), block([record(SAME, size=0)], actions=b"[")],
        [step(Kind.RESET, observation=BLACK), block([record(size=len(BLACK))] * 13, BLACK * 13)],
        [block([record()] * 2, bytes(16), kind=Kind.RESET)],
        [step(Kind.RESET, layout=1, flags=64)],
        *(
            [step(Kind.RESET, layout=1), message(Kind.CHANGED, made)]
            for made in ({}, {"at": 1}, {"at": -1}, {"at": True})
        ),
        [message(Kind.CHANGED, {"at": 0})],
        [message(Kind.SPACE, {"name": "space"})],
        [message(Kind.SPACE, {"name": "action_space"})] * 2,
    ],
)
def test_steps_that_cannot_be_are_forged(messages: list[bytes]) -> None:
    with pytest.raises(Forged):
        frames(*messages)


def test_a_block_has_only_so_many_steps() -> None:
    for count in (MAX_STEPS, MAX_STEPS + 1):
        made = recording(100)
        reader = Reader(made)
        reader.feed(message(Kind.LAYOUT, PICTURE) + step(Kind.RESET, observation=BLACK))
        if count > MAX_STEPS:
            with pytest.raises(Forged):
                reader.feed(run(count))
        else:
            reader.feed(run(count))
            assert made.trace.steps == count


def test_each_step_requests_an_action() -> None:
    reader = Reader(recording(), played=True)
    reader.feed(message(Kind.LAYOUT, PICTURE) + step(Kind.RESET, observation=BLACK))
    with pytest.raises(Forged, match="block"):
        reader.feed(run())


def framed(*messages: bytes, keep: int = 0) -> TraceBuilder:
    """What is read of these messages, where layout 0 is that of frames, 1 of others, and 2 one that is not allowed."""
    made = TraceBuilder(
        Rollout(0, [[0, 0, 0]] * 8, Conditions(render=True), keep=keep),
        read_space(ARCADE.observation),
        read_space(ARCADE.action),
    )
    layouts = (FRAMES, FLOAT, FRAMES | {"shape": [84, 63, 4]})
    Reader(made).feed(b"".join(message(Kind.LAYOUT, layout) for layout in layouts) + b"".join(messages))
    return made


def digests(count: int, *, flags: int = 0, kind: Kind = Kind.STEPS, layout: int = 0, picture: bytes = b"") -> bytes:
    size = DIGEST + len(picture)
    values = b"".join(bytes([number]) * DIGEST + picture for number in range(count))
    return block([record(FRAME | flags, layout=layout, size=size)] * count, values, kind=kind)


def test_frames_are_known_by_their_digests() -> None:
    made = framed(digests(1, kind=Kind.RESET, flags=RENDERED), digests(3, flags=RENDERED)).trace
    assert made.observations == [bytes(DIGEST), *(bytes([number]) * DIGEST for number in range(3))]
    assert (made.rewards, made.renders, made.render_problems, made.overwritten) == ([1.0] * 3, 4, [], [])


def test_render_may_differ_and_an_observation_may_change() -> None:
    head = VALUE.pack(FRAME, 0)
    other, wrong = b"x" * DIGEST, message(Kind.RENDER, VALUE.pack(FRAME, 2) + bytes(DIGEST))
    made = framed(
        digests(1, kind=Kind.RESET),
        digests(1),
        *[message(Kind.CHANGED, {"at": 0})] * 9,
        message(Kind.RENDER, head + other),
        wrong,
    ).trace
    assert made.overwritten == [(0, 1)] * 3
    assert [problem.kind for problem in made.render_problems] == ["differs", "format"]


def test_pictures_come_as_requested() -> None:
    made = framed(digests(1, kind=Kind.RESET, picture=BLACK), digests(1, picture=BLACK), digests(2), keep=2).trace
    assert [frame.shape for frame in made.frames] == [(84, 84, 3)] * 2
    assert len(made.observations) == 4


@pytest.mark.parametrize(
    ("keep", "messages"),
    [
        (0, [digests(1, kind=Kind.RESET, layout=1)]),
        (0, [digests(1, kind=Kind.RESET, layout=2)]),
        (0, [step(Kind.RESET, observation=BLACK)]),
        (0, [step(Kind.RESET, observation=bytes(DIGEST))]),
        (0, [step(Kind.RESET, observation=bytes(DIGEST - 1), flags=FRAME)]),
        (0, [step(Kind.RESET, observation=b"", flags=FRAME | SAME)]),
        (0, [digests(1, kind=Kind.RESET, picture=BLACK)]),
        (1, [digests(1, kind=Kind.RESET)]),
        (1, [digests(1, kind=Kind.RESET, picture=BLACK[1:])]),
        (2, [digests(1, kind=Kind.RESET, picture=BLACK), digests(1)]),
        (0, [digests(1, kind=Kind.RESET), digests(9)]),
        (0, [digests(1, kind=Kind.RESET), digests(3, layout=1)]),
        (0, [digests(1, kind=Kind.RESET), digests(3, layout=9)]),
        (0, [digests(1, kind=Kind.RESET), message(Kind.RENDER, VALUE.pack(FRAME, 0))]),
        (0, [digests(1, kind=Kind.RESET), message(Kind.RENDER, VALUE.pack(0, 0) + BLACK)]),
        (0, [digests(1, kind=Kind.RESET), message(Kind.RENDER, VALUE.pack(FRAME | SAME, 0))]),
        (0, [message(Kind.LAYOUT, FRAMES | {"dtype": "<f4"})]),
        (0, [message(Kind.LAYOUT, FRAMES | {"shape": [3]})]),
        (0, [message(Kind.LAYOUT, FRAMES | {"shape": [-1, 84, 84]})]),
        (0, [message(Kind.LAYOUT, FRAMES | {"columns": 1})]),
        (0, [message(Kind.LAYOUT, FRAMES | {"columns": True}), message(Kind.LAYOUT, FRAMES | {"columns": False})]),
    ],
)
def test_frames_that_cannot_be_are_forged(keep: int, messages: list[bytes]) -> None:
    with pytest.raises(Forged):
        framed(*messages, keep=keep)


class Kept(Channel):
    """A channel that keeps what it would send; without `leaving_out`, each step in full and by itself."""

    def __init__(self, leaving_out: bool, job: Job | None = None) -> None:
        with socket.socket(socket.AF_UNIX) as nobody:
            super().__init__(nobody, every_step=not leaving_out, shown=Frames(job))
        self.kept = b""
        self._leaving_out = leaving_out

    def _write(self, parts: list[bytes], size: int) -> None:
        self.kept += b"".join(parts)

    def step(self, *values: Any, **named: Any) -> None:
        if not self._leaving_out:
            self._last, self._info = (-1, b""), None
        super().step(*values, **named)


VALUES = [
    np.full((84, 84, 3), 7, np.uint8),
    np.zeros(3),
    np.full((84, 84, 3), 9, np.int16),
    np.array([None, "x"], dtype=object),
    np.zeros(2, [("a", "i4"), ("b", "f8")]),
    np.zeros(3, ">f8"),
    np.datetime64(7, "s"),
    np.zeros(1, "i4, f8")[0],
    np.str_(""),
    np.bytes_(b""),
    np.zeros(2, "U0"),
    np.zeros((1,) * 40),
    np.zeros((0, 10_000_000)),
    {"one": np.zeros(5 * 1024**2, np.uint8), "two": np.zeros(5 * 1024**2, np.uint8)},
    dict.fromkeys(range(5_000), 1),
    [1, "x"] * 2_500,
    list(range(5_000)),
]
EPISODE = st.lists(
    st.tuples(
        st.sampled_from([0, 0, 0, *range(len(VALUES))]), st.booleans(), st.sampled_from([0.0, 1, True]), st.booleans()
    ),
    max_size=40,
)


@settings(max_examples=40, deadline=None)
@given(EPISODE, st.integers(0, 9), st.booleans())
def test_what_the_worker_leaves_out_comes_back(episode: list[Any], keep: int, watch: bool) -> None:
    made = []
    for leaving_out in (True, False):
        builder = TraceBuilder(
            Rollout(0, [[0, 0, 0]] * len(episode), Conditions(render=True), keep=keep),
            read_space(ARCADE.observation),
            read_space(ARCADE.action),
            watch=watch,
        )
        job: Any = {"pictures": builder.pictures} | ({"frame": builder.frame} if leaving_out else {})
        channel = Kept(leaving_out, job)
        channel.step(Kind.RESET, VALUES[0], 0.0, False, False, {}, 0.0)
        for value, info, reward, flag in episode:
            channel.step(Kind.STEPS, VALUES[value], reward, flag, False, {"a": 1} if info else {}, 0.001)
            channel.render(VALUES[0])
        channel.send_json(Kind.END, {}, flush=True)
        made.append((builder, channel.kept))
        Reader(builder).feed(channel.kept)
    (one, short), (other, long) = made
    assert len(short) <= len(long) + 100
    for name in ("frames", "rendered"):
        pictures = [[picture.tobytes() for picture in getattr(builder.trace, name)] for builder in (one, other)]
        assert pictures[0] == pictures[1]
        assert all(len(getattr(builder.trace, name)) <= keep for builder in (one, other))
    compared = [vars(builder.trace) | {"frames": [], "rendered": []} for builder in (one, other)]
    assert compared[0] == compared[1]


@pytest.mark.parametrize(
    "value", [np.full((84, 84, 3), "a"), np.full((84, 84, 3), b"a"), np.zeros((84, 84, 3), complex)]
)
def test_other_frames_keep_only_their_type(value: Any) -> None:
    channel = Kept(True)
    channel.step(Kind.RESET, value, 0.0, False, False, {}, 0.0)
    channel.flush()
    made = TraceBuilder(Rollout(0, [], keep=1), read_space(ARCADE.observation), read_space(ARCADE.action))
    Reader(made).feed(channel.kept)
    assert [problem.kind for problem in made.trace.problems] == ["type"]
    assert not made.trace.frames


def long_infos(steps: int, odd: int = -1) -> TraceBuilder:
    made = recording(steps)
    reader = Reader(made)
    reader.feed(message(Kind.LAYOUT, FLOAT) + step(Kind.RESET))
    for number in range(steps):
        info = {"number": number + (number == odd), "text": "x" * 60_000}
        reader.feed(step(Kind.STEPS, info=json.dumps(info).encode()))
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
