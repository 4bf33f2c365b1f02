"""Values against JSON descriptions of spaces."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from envcraft.spaces.sampling import enumerate_actions, sample
from envcraft.spaces.spec import difference, read_space
from envcraft.spaces.validation import validate

FRAME = {"type": "Box", "low": 0, "high": 255, "shape": [2, 3], "dtype": "uint8"}
REAL = {"type": "Box", "low": -1.0, "high": [0.0, 1.0], "shape": [2], "dtype": "float32"}
PAD = {"type": "MultiDiscrete", "nvec": [5, 2, 2], "start": [0, 0, 0], "dtype": "int64"}
BUTTON = {"type": "Discrete", "n": 3, "start": 1}
BITS = {"type": "MultiBinary", "shape": [4]}
WORDS = {"type": "Text", "min_length": 1, "max_length": 3, "charset": "ab"}
WIDE = {"type": "Box", "low": 0, "high": 2**64 - 1, "shape": [2], "dtype": "uint64"}
LONG = {"type": "MultiDiscrete", "nvec": [[2] * 10] * 7, "start": [[0] * 10] * 7, "dtype": "int64"}
GRAPH = {"type": "Graph", "nodes": REAL, "edges": BUTTON}
NODES = np.zeros((1, 2), np.float32)
ALL = [WIDE, LONG, FRAME, REAL, PAD, BUTTON, BITS, WORDS]
BOTH = {"type": "Dict", "spaces": [["frame", FRAME], ["pair", {"type": "Tuple", "spaces": [BUTTON, WORDS]}]]}


@pytest.mark.parametrize(
    ("space", "value", "kind", "words"),
    [
        (FRAME, np.zeros((2, 3), np.uint8), None, ""),
        (FRAME, np.zeros((2, 3), np.float64), "type", "dtype float64"),
        (FRAME, np.zeros((3, 2), np.uint8), "type", "shape"),
        (FRAME, [[0, 0, 0], [0, 0, 0]], "type", "list"),
        (FRAME, None, "type", "None"),
        (REAL, np.array([0.0, 1.0], np.float32), None, ""),
        (REAL, np.array([0.5, 0.0], np.float32), "range", r"\[0\] is 0.5"),
        (REAL, np.array([0.0, np.nan], np.float32), "range", r"\[1\] is nan"),
        (REAL, np.array([0.0, -np.inf], np.float32), "range", r"\[1\] is -inf"),
        (BUTTON, 3, None, ""),
        (BUTTON, np.int64(1), None, ""),
        (BUTTON, 0, "range", "0"),
        (BUTTON, 4, "range", "4"),
        (BUTTON, True, "type", "bool"),
        (BUTTON, 1.0, "type", "float"),
        (PAD, np.array([4, 1, 1]), None, ""),
        (PAD, np.array([5, 0, 0]), "range", r"\[0\] is 5"),
        (PAD, np.array([-1, 0, 0]), "range", r"\[0\] is -1"),
        (PAD, np.array([0.0, 0.0, 0.0]), "type", "float64"),
        (BITS, np.array([0, 1, 1, 2]), "range", r"\[3\] is 2"),
        (WORDS, "ab", None, ""),
        (WORDS, "abba", "range", "4 characters, not of 1 to 3"),
        (WORDS, "c", "range", "the character 'c', which the charset"),
        (WORDS, b"a", "type", "bytes"),
        (BOTH, {"frame": np.zeros((2, 3), np.uint8), "pair": (1, "a")}, None, ""),
        (BOTH, {"frame": np.zeros((2, 3), np.uint8)}, "type", "keys"),
        (BOTH, {"frame": np.zeros((2, 3), np.uint8), "pair": (0, "a")}, "range", r"\[pair\]\[0\]"),
        (BOTH, {"frame": np.zeros((2, 3), np.uint8), "pair": [1, "a"]}, "type", "list"),
        (GRAPH, (NODES, np.array([1]), np.zeros((1, 2), int)), None, ""),
        (GRAPH, (np.array(3.0), None, None), "type", "GraphInstance"),
        (GRAPH, (NODES, np.array(1), np.zeros((1, 2), int)), "type", "edges"),
    ],
)
def test_validate(space: dict[str, Any], value: Any, kind: str | None, words: str) -> None:
    found = validate(read_space(space), value)
    assert (found and found[0]) == kind
    if found:
        assert re.search(words, found[1])


@given(st.sampled_from(ALL), st.integers(0, 2**32))
def test_samples_are_inside(space: dict[str, Any], seed: int) -> None:
    value = sample(read_space(space), np.random.default_rng(seed))
    if space["type"] in ("Box", "MultiDiscrete", "MultiBinary"):
        value = np.asarray(value, dtype=space.get("dtype", "int8"))
    assert validate(read_space(space), value) is None


def test_every_joint_action_once_and_nothing_first() -> None:
    found = enumerate_actions(read_space(PAD))
    assert len(found) == len({tuple(action) for action in found}) == 20
    assert found[0] == [0, 0, 0]


def test_of_more_joint_actions_than_can_be_counted_there_is_a_sample() -> None:
    found = [np.array(action) for action in enumerate_actions(read_space(LONG))]
    assert len({action.tobytes() for action in found}) == 64
    assert not found[0].any()
    assert found[-1].all()


@pytest.mark.parametrize(
    ("change", "same"),
    [({}, True), ({"low": 0.0}, True), ({"high": 1}, False), ({"shape": [3, 2]}, False), ({"dtype": "float32"}, False)],
)
def test_same_compares_bounds_shape_and_dtype(change: dict[str, Any], same: bool) -> None:
    assert (read_space(FRAME) == read_space({**FRAME, **change})) is same


@pytest.mark.parametrize(
    ("one", "two", "words"),
    [
        (BITS, {**BITS, "shape": [3]}, ("", "MultiBinary(4)", "MultiBinary(3)")),
        (BITS, {**BITS, "shape": [2, 2]}, ("", "MultiBinary(4)", "MultiBinary((2, 2))")),
        (WORDS, {**WORDS, "max_length": 40}, ("", "Text(1, 3, charset='ab')", "Text(1, 40, charset='ab')")),
        (
            {**WORDS, "charset": "abcdefghijklmnopqrstu"},
            {**WORDS, "charset": "abcdefghijklmnopqrstuv"},
            (
                "",
                "Text(1, 3, charset='abcdefghijklmnopqrst…') without 'v'",
                "Text(1, 3, charset='abcdefghijklmnopqrst…') with 'v'",
            ),
        ),
        (BUTTON, {**BUTTON, "start": 0}, ("", "Discrete(3, start=1)", "Discrete(3)")),
        (
            PAD,
            {**PAD, "start": [1, 0, 0]},
            ("", "MultiDiscrete([5, 2, 2])", "MultiDiscrete([5, 2, 2], start=[1, 0, 0])"),
        ),
        (PAD, {**PAD, "dtype": "int8"}, ("", "MultiDiscrete([5, 2, 2])", "MultiDiscrete([5, 2, 2], dtype=int8)")),
        (
            REAL,
            {**REAL, "high": [0.0, 2.0]},
            ("[1]", "Box(-1.0, 1.0, (2,), float32)", "Box(-1.0, 2.0, (2,), float32)"),
        ),
        (FRAME, {**FRAME, "high": 1}, ("", "Box(0, 255, (2, 3), uint8)", "Box(0, 1, (2, 3), uint8)")),
        (
            {"type": "Dict", "spaces": [["arm", REAL], ["key", BUTTON]]},
            {"type": "Dict", "spaces": [["arm", {**REAL, "low": [-1.0, -3.0]}], ["key", BUTTON]]},
            ("[arm][1]", "Box(-1.0, 1.0, (2,), float32)", "Box(-3.0, 1.0, (2,), float32)"),
        ),
    ],
)
def test_the_texts_of_spaces_differ_where_these_do(one: dict[str, Any], two: dict[str, Any], words: Any) -> None:
    assert difference(read_space(one), read_space(two)) == words
