"""Hypothesis holds SpaceSpec against Gymnasium's own spaces: ``contains``, ``sample``, flattening and equality."""

from __future__ import annotations

import json
from typing import Any, get_args

import numpy as np
from envcraft_protocol.spaces import Form, decode_action, describe, encode_action
from gymnasium import spaces
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from envcraft.spaces.gymnasium import from_gymnasium, to_gymnasium
from envcraft.spaces.sampling import enumerate_actions, sample
from envcraft.spaces.spec import read_space
from envcraft.spaces.validation import validate, validate_action

_SHAPES = st.lists(st.integers(1, 3), min_size=1, max_size=3).map(tuple)
_SEEDS = st.integers(0, 2**32 - 1)
_DTYPES = ["bool", "uint8", "int16", "int64", "float32", "float64"]


@st.composite
def boxes(draw: st.DrawFn) -> spaces.Space[Any]:
    shape, dtype = draw(_SHAPES), np.dtype(draw(st.sampled_from(_DTYPES)))
    rng = np.random.default_rng(draw(_SEEDS))
    if dtype.kind == "f":
        low = rng.normal(size=shape)
        high = low + rng.exponential(size=shape)
        low[rng.random(shape) < 0.2], high[rng.random(shape) < 0.2] = -np.inf, np.inf
    else:
        low, high = np.sort(rng.integers(0, 2 if dtype.kind == "b" else 100, (2, *shape)), axis=0)
    if draw(st.booleans()):
        low, high = np.full(shape, low.flat[0]), np.full(shape, high.flat[0])
    return spaces.Box(low.astype(dtype), high.astype(dtype), shape, dtype.type)


@st.composite
def multi_discretes(draw: st.DrawFn) -> spaces.Space[Any]:
    rng = np.random.default_rng(draw(_SEEDS))
    shape = draw(_SHAPES)
    return spaces.MultiDiscrete(rng.integers(1, 6, shape), start=rng.integers(-3, 4, shape))


leaves = st.one_of(
    boxes(),
    multi_discretes(),
    st.builds(spaces.Discrete, st.integers(1, 9), start=st.integers(-9, 9)),
    # Gymnasium takes one axis for a number, and compares the two forms as unequal.
    st.builds(lambda shape: spaces.MultiBinary(shape if len(shape) > 1 else shape[0]), _SHAPES),
    st.builds(spaces.Text, st.integers(1, 5), charset=st.sampled_from(["ab", "01x"])),
)


def composed(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    parts = st.lists(inner, min_size=1, max_size=3)
    return st.one_of(
        st.builds(spaces.Tuple, parts),
        st.builds(spaces.Dict, st.dictionaries(st.sampled_from("abc"), inner, min_size=1, max_size=3)),
    )


#: The spaces whose values a sandbox exchanges.
exchanged = st.recursive(leaves, composed, max_leaves=5)
every = st.one_of(
    exchanged,
    st.builds(spaces.OneOf, st.lists(exchanged, min_size=1, max_size=3)),
    st.builds(spaces.Sequence, exchanged),
    st.builds(spaces.Graph, boxes(), st.one_of(st.none(), st.builds(spaces.Discrete, st.integers(1, 9)))),
)


@settings(deadline=None, max_examples=50)
@given(every)
def test_a_description_is_read_and_survives_json(space: spaces.Space[Any]) -> None:
    spec = from_gymnasium(space)
    assert spec.known
    assert spec == read_space(json.loads(json.dumps(describe(space))))
    assert hash(spec) == hash(from_gymnasium(space))


@settings(deadline=None, max_examples=50)
@given(exchanged)
def test_a_space_comes_back_from_its_description(space: spaces.Space[Any]) -> None:
    assert to_gymnasium(from_gymnasium(space), "the space") == space


@settings(deadline=None, max_examples=50)
@given(every, _SEEDS)
def test_what_gymnasium_samples_is_valid(space: spaces.Space[Any], seed: int) -> None:
    space.seed(seed)
    value = space.sample()
    spec = from_gymnasium(space)
    assert validate(spec, value, exact=False) is None
    assert validate(spec, value) is None


@settings(deadline=None, max_examples=50)
@given(every, _SEEDS)
def test_what_is_drawn_is_contained(space: spaces.Space[Any], seed: int) -> None:
    spec, rng = from_gymnasium(space), np.random.default_rng(seed)
    for drawn in [sample(spec, rng), *enumerate_actions(spec, 4)]:
        assert validate_action(spec, drawn) == ""
        for form in get_args(Form):
            value = decode_action(describe(space), json.loads(json.dumps(drawn)), form)
            assert space.contains(value) or _rounded(space)


@settings(deadline=None, max_examples=50)
@given(exchanged, exchanged, _SEEDS)
def test_values_of_another_space_are_judged_as_contains_does(
    space: spaces.Space[Any], other: spaces.Space[Any], seed: int
) -> None:
    assume(not _rounded(space))
    other.seed(seed)
    value = other.sample()
    try:
        contained = space.contains(value)
    except Exception:
        # Gymnasium raises for some values that have another structure.
        contained = False
    assert (validate(from_gymnasium(space), value, exact=False) is None) == contained


@settings(deadline=None, max_examples=50)
@given(exchanged, _SEEDS)
def test_encoded_actions_flatten_to_the_same_vector(space: spaces.Space[Any], seed: int) -> None:
    space.seed(seed)
    action = space.sample()
    back = decode_action(describe(space), json.loads(json.dumps(encode_action(space, action))))
    assert validate_action(from_gymnasium(space), encode_action(space, action)) == ""
    flat: Any = spaces.flatten(space, action)
    assert np.array_equal(spaces.flatten(space, back), flat)  # type: ignore[arg-type]
    assert np.array_equal(spaces.flatten(to_gymnasium(from_gymnasium(space), "the space"), action), flat)  # type: ignore[arg-type]


def _rounded(space: Any) -> bool:
    """Whether a space has a float Box: samples in float64 may round out of it, and validation forgives rounding."""
    if isinstance(space, spaces.Dict):
        return any(map(_rounded, space.spaces.values()))
    if isinstance(space, spaces.Tuple | spaces.OneOf):
        return any(map(_rounded, space.spaces))
    if isinstance(space, spaces.Sequence):
        return _rounded(space.feature_space)
    if isinstance(space, spaces.Graph):
        return _rounded(space.node_space)
    return isinstance(space, spaces.Box) and np.dtype(space.dtype).kind == "f"
