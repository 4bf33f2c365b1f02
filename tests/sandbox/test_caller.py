"""How the conditions of a rollout change the values that step() receives."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from envcraft_protocol.spaces import decode_action, describe
from envcraft_sandbox.worker.caller import Caller
from gymnasium import spaces

PAD = spaces.MultiDiscrete([5, 2, 2])


def calling(space: spaces.Space[Any], **conditions: bool) -> Caller:
    spec = describe(space)
    subject: Any = SimpleNamespace(
        action=lambda chosen, env, form="own": decode_action(spec, chosen, form),
        call=lambda phase, function: function(),
    )
    made: Any = conditions
    return Caller(subject, SimpleNamespace(action_space=space), made)


def test_the_same_array_is_overwritten() -> None:
    caller = calling(PAD, reuse=True)
    first = caller.action([1, 0, 0])
    assert first.tolist() == [1, 0, 0]
    assert caller.action([4, 1, 0]) is first
    assert first.tolist() == [4, 1, 0]


def test_forms_take_turns_and_all_that_was_passed_is_overwritten() -> None:
    caller = calling(PAD, reuse=True, int32=True, python=True)
    first, second, third = (caller.action([number, 1, 0]) for number in range(3))
    assert (first.dtype, type(second)) == (np.int32, list)
    assert third is first
    assert (first.tolist(), second) == ([2, 1, 0], [2, 1, 0])


def test_without_reuse_each_action_is_new() -> None:
    caller = calling(PAD, int32=True)
    first = caller.action([1, 0, 0])
    assert caller.action([2, 0, 0]) is not first
    assert first.tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    ("space", "chosen", "conditions", "value"),
    [
        (spaces.Discrete(3), 2, {"python": True}, 2),
        (spaces.Discrete(3), 2, {"int32": True}, np.int32(2)),
        (spaces.Discrete(3, dtype=np.int8), 2, {"int32": True}, np.int64(2)),
        (spaces.MultiDiscrete([2**40]), [2**35], {"int32": True}, np.array([2**35])),
        (spaces.Box(0, 1, (1,), np.float64), [0.5], {"int32": True, "python": True}, np.array([0.5])),
    ],
)
def test_only_integers_that_the_space_contains_change(
    space: spaces.Space[Any], chosen: Any, conditions: dict[str, bool], value: Any
) -> None:
    passed = calling(space, **conditions).action(chosen)
    assert (type(passed), passed) == (type(value), value)
    assert getattr(passed, "dtype", None) == getattr(value, "dtype", None)


def test_arrays_in_dictionaries_are_overwritten() -> None:
    space = spaces.Dict(push=spaces.Box(-1, 1, (2,)), turn=spaces.Tuple([PAD]))
    caller = calling(space, reuse=True)
    first = caller.action({"push": [0, 0], "turn": [[1, 0, 0]]})
    push, turn = first["push"], first["turn"][0]
    assert caller.action({"push": [1, 0], "turn": [[2, 1, 1]]}) is first
    assert (push.tolist(), turn.tolist()) == ([1, 0], [2, 1, 1])
