"""What the worker says of a file, its spaces and a search is read if it has the right form, and else refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces as gym_spaces
from hypothesis import given
from hypothesis import strategies as st

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import MalformedValue
from envcraft.judging.description import describe, outcome
from envcraft.spaces.sampling import enumerate_actions, sample
from envcraft.spaces.spec import KINDS, read_space
from envcraft.spaces.validation import validate_action

BOX = {"type": "Box", "low": 0, "high": 1, "shape": [2], "dtype": "float32"}
GOOD_SPACES: list[dict[str, Any]] = [
    BOX,
    {**BOX, "low": "-inf", "high": ["inf", 3.5]},
    {**BOX, "low": None, "high": None},
    {**BOX, "shape": [0], "low": [], "high": []},
    {"type": "Discrete", "n": 3, "start": -1},
    {"type": "MultiDiscrete", "nvec": [[2, 3], [4, 5]], "start": [[0, 0], [0, 1]], "dtype": "int32"},
    {"type": "MultiBinary", "shape": [3, 2]},
    {"type": "Text", "min_length": 0, "max_length": 4, "charset": "ab"},
    {"type": "Dict", "spaces": [["a", BOX], ["b", {"type": "Tuple", "spaces": [BOX]}]]},
    {"type": "Sequence", "space": BOX, "stack": True},
    {"type": "Graph", "nodes": BOX, "edges": None},
    {"type": "Graph", "nodes": BOX, "edges": {"type": "Discrete", "n": 2, "start": 0}},
    {"type": "OneOf", "spaces": [BOX, {"type": "Discrete", "n": 2, "start": 0}]},
    {"type": "somebody.Space", "repr": "?", "spaces": 5, "space": "?"},
]
#: Those that actions can be drawn from.
ACTION_SPACES = [space for space in GOOD_SPACES if read_space(space).known and space.get("low", 0) is not None]
_READ = [read_space(space) for space in ACTION_SPACES]
BAD_SPACES: list[Any] = [
    "Box",
    ["Box"],
    {},
    {"type": 3},
    {"type": "Box"},
    {**BOX, "shape": "x"},
    {**BOX, "shape": [-1]},
    {**BOX, "shape": [True]},
    {**BOX, "shape": [10**6, 10**6]},
    {**BOX, "dtype": "O"},
    {**BOX, "dtype": "no such type"},
    {**BOX, "dtype": ","},
    {**BOX, "dtype": "04"},
    {**BOX, "low": "low"},
    {**BOX, "low": [1, 2, 3]},
    {**BOX, "low": 2},
    {**BOX, "low": "nan"},
    {**BOX, "low": {"a": 1}},
    {"type": "Discrete", "n": 0, "start": 0},
    {"type": "Discrete", "n": 10**30, "start": 0},
    {"type": "Discrete", "n": 2.5, "start": 0},
    {"type": "MultiDiscrete", "nvec": "many", "start": [0]},
    {"type": "MultiDiscrete", "nvec": [2], "start": [0, 0]},
    {"type": "MultiDiscrete", "nvec": [0], "start": [0]},
    {"type": "MultiDiscrete", "nvec": [10**30], "start": [0]},
    {"type": "Text", "min_length": 3, "max_length": 1, "charset": "a"},
    {"type": "Text", "min_length": 0, "max_length": 1, "charset": ""},
    {"type": "Dict", "spaces": [BOX]},
    {"type": "Dict", "spaces": 5},
    {"type": "Tuple", "spaces": [{"type": "Box"}]},
    {**BOX, "low": [0]},
    {"type": "Sequence", "space": BOX},
    {"type": "Sequence", "space": None, "stack": True},
    {"type": "Sequence", "space": BOX, "stack": "yes"},
    {"type": "Graph", "nodes": None, "edges": None},
    {"type": "Graph", "nodes": BOX, "edges": {"type": "Box"}},
    {"type": "OneOf", "spaces": []},
    {"type": "OneOf", "spaces": [5]},
]


@pytest.mark.parametrize("space", GOOD_SPACES)
def test_spaces_are_read_and_can_be_used(space: dict[str, Any]) -> None:
    read = read_space(space)
    assert str(read)
    if read.known and space.get("low", 0) is not None:
        sample(read, np.random.default_rng(0))
        enumerate_actions(read)
    assert read.known == (space["type"] in KINDS)


@pytest.mark.parametrize("space", BAD_SPACES)
def test_spaces_of_another_form_are_refused(space: Any) -> None:
    with pytest.raises(MalformedValue):
        read_space(space)


def test_what_the_worker_says_of_spaces_is_read() -> None:
    from envcraft_protocol import spaces as worker

    for space in (
        gym_spaces.Box(-np.inf, np.inf, (3,)),
        gym_spaces.Box(np.array([0.0, -1.0]), np.array([np.inf, 1.0]), dtype=np.float64),
        gym_spaces.Box(0, 255, (84, 84, 3), np.uint8),
        gym_spaces.Box(0, 1, (), np.float32),
        gym_spaces.Discrete(4, start=-2),
        gym_spaces.MultiDiscrete(np.array([[2, 3], [4, 5]])),
        gym_spaces.MultiBinary((2, 2)),
        gym_spaces.Text(5),
        gym_spaces.Dict(a=gym_spaces.Discrete(2), b=gym_spaces.Tuple([gym_spaces.MultiBinary(2)])),
        gym_spaces.Sequence(gym_spaces.Box(0, 1, (2,)), stack=True),
        gym_spaces.Graph(gym_spaces.Box(0, 1, (2,)), gym_spaces.Discrete(3)),
        gym_spaces.Graph(gym_spaces.Discrete(3), None),
        gym_spaces.OneOf([gym_spaces.Discrete(2), gym_spaces.Text(3)]),
    ):
        read_space(worker.describe(space))


def test_a_nested_space_has_a_bottom() -> None:
    space: dict[str, Any] = BOX
    for _ in range(50):
        space = {"type": "Tuple", "spaces": [space]}
    with pytest.raises(MalformedValue, match="deeply"):
        read_space(space)


@pytest.mark.parametrize(
    "told",
    [
        {"classes": [5]},
        {"classes": [{"name": 5, "line": None}]},
        {"lookalikes": 7},
        {"wrappers": "Slow"},
        {"effects": {"seconds": "long"}},
        {"class": {"a": 1}},
        {"line": "x"},
        {"required": 3},
        {"lines": {"step": "x"}},
        {"reset": [[], {}]},
        {"render_modes": {"rgb_array": 1}},
        {"rendering": {"takes": True}},
        {"rendering": {"takes": 1, "optional": True, "given": None, "kept": None, "rate": True}},
        {"module": 5},
        {"sha256": "0" * 63},
        {"sha256": "0" * 64 + "\n"},
        {"modules": [None]},
        {"made": ["Env"]},
        {"environment": "no"},
        {"nondeterministic": 1},
        {"observation_space": "Box"},
        {"action_space": {"type": "Discrete", "n": -1, "start": 0}},
    ],
)
def test_a_description_of_another_form_is_refused(told: dict[str, Any]) -> None:
    with pytest.raises(MalformedValue):
        describe(told)


@pytest.mark.parametrize(
    "told",
    [
        {"win": 5},
        {"win": [[9, 9, 9]]},
        {"best": [[0, 0]]},
        {"crash": ["up"]},
        {"win": [{}]},
        {"win": [[0, 0, 0]] * 5},
        {"steps": "many"},
        {"states": [1]},
        {"loop": [[9, 9, 9]], "loop_length": 1},
        {"loop": [[0, 0, 0]] * 5, "loop_length": 1},
        {"loop": [[0, 0, 0]], "loop_length": 2},
        {"loop_length": 1},
        {"place": "gems\x1b[2J"},
        {"board": "w" * 10_000},
        {"enclosed": [-1], "looked": 1},
        {"enclosed": [0, 1], "looked": 1},
        {"enclosed": [], "looked": 10**6},
        {"loop": [[0, 0, 0]], "loop_length": -1},
        {"paid": -1},
    ],
)
def test_an_outcome_of_another_form_is_refused(told: dict[str, Any]) -> None:
    with pytest.raises(MalformedValue):
        outcome(told, read_space(ARCADE.action), 4)


def test_an_outcome_is_read() -> None:
    told = {"win": [[4, 1, 0]], "best": None, "steps": 3, "copies": True, "best_return": "-inf"}
    assert outcome(told, read_space(ARCADE.action), 4) == {"win": [[4, 1, 0]], "best": None, "steps": 3}


@given(st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4), st.lists))
def test_any_action_is_refused_or_in_the_space(action: Any) -> None:
    for space in _READ:
        assert isinstance(validate_action(space, action), str)


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_what_is_drawn_from_a_space_is_in_it(space: dict[str, Any]) -> None:
    rng = np.random.default_rng(0)
    for action in [*enumerate_actions(read_space(space)), *(sample(read_space(space), rng) for _ in range(20))]:
        assert validate_action(read_space(space), action) == ""


@pytest.mark.parametrize(
    ("space", "action"),
    [
        ({"type": "Tuple", "spaces": [BOX]}, [[0, 2]]),
        ({"type": "Tuple", "spaces": [BOX]}, []),
        ({"type": "Dict", "spaces": [["a", BOX]]}, {"a": [0, 1], "b": 0}),
        ({"type": "Dict", "spaces": [["a", BOX]]}, {"a": [0]}),
        ({"type": "Sequence", "space": BOX, "stack": True}, [[0, 1], [0, 2]]),
        ({"type": "OneOf", "spaces": [BOX]}, [1, [0, 1]]),
        ({"type": "OneOf", "spaces": [BOX]}, [-1, [0, 1]]),
        ({"type": "OneOf", "spaces": [BOX]}, [0, [0, 2]]),
        ({"type": "Graph", "nodes": BOX, "edges": None}, {"nodes": [[0, 1]], "edges": [0], "links": [[0, 0]]}),
        ({"type": "Graph", "nodes": BOX, "edges": BOX}, {"nodes": [[0, 1]], "edges": [[0, 1]], "links": [[0, 1]]}),
        ({"type": "Graph", "nodes": BOX, "edges": BOX}, {"nodes": [[0, 1]], "edges": [[0, 1]], "links": []}),
    ],
)
def test_an_action_with_a_wrong_part_is_refused(space: dict[str, Any], action: Any) -> None:
    words = validate_action(read_space(space), action)
    assert words.count(str(read_space(space))) == 1, words
