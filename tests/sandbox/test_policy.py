"""The state that a policy reads."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from envcraft_sandbox.worker.policy import ReadOnlyState, State


def test_attributes_are_the_environments_own() -> None:
    state = State(SimpleNamespace(x=3, _hidden=4))
    assert (state.x, state["x"], state._hidden) == (3, 3, 4)
    assert (state.get("x"), state.get("y", 5), sorted(state.keys())) == (3, 5, ["_hidden", "x"])
    assert vars(state) == {"x": 3, "_hidden": 4}
    with pytest.raises(AttributeError):
        state.y  # noqa: B018
    with pytest.raises(KeyError):
        state["y"]


def test_a_game_may_have_keys_to_get() -> None:
    state = State(SimpleNamespace(keys={"red"}, get=7))
    assert state.keys == state["keys"] == {"red"}
    assert state["get"] == 7


def test_nothing_is_set_or_deleted() -> None:
    env = SimpleNamespace(x=3)
    with pytest.raises(ReadOnlyState, match="x cannot be set"):
        State(env).x = 4
    with pytest.raises(ReadOnlyState, match="x cannot be deleted"):
        del State(env).x
    assert env.x == 3
