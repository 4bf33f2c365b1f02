"""What is said of two traces that differ."""

from __future__ import annotations

import json
from typing import Any

import pytest

from envcraft.model.rollout import Rollout
from envcraft.model.trace import Divergence, Fault, Trace, digest, diverge, info_digest


def trace(info: Any) -> Trace:
    return Trace(Rollout(0, []), observations=[b"0"], infos=[json.dumps(info).encode()])


@pytest.mark.parametrize(
    ("one", "two", "values"),
    [
        ({"a": {"b": 1, "c": 2}}, {"a": {"b": 1, "c": 3}}, ({"a.c": 2}, {"a.c": 3})),
        ({"a": [0, {"b": 1}]}, {"a": [0, {"b": None}]}, ({"a.1.b": 1}, {"a.1.b": None})),
        ({"a": None}, {}, ({"a": None}, {"a": "(absent)"})),
        ({"a": [1]}, {"a": [1, 2]}, ({"a.1": "(absent)"}, {"a.1": 2})),
        ({"a": float("nan"), "b": {}}, {"a": float("nan"), "b": 2}, ({"b": {}}, {"b": 2})),
        ({"": 1}, {"": 2}, ({"''": 1}, {"''": 2})),
    ],
)
def test_the_path_to_what_differs_is_named(one: Any, two: Any, values: tuple[Any, Any]) -> None:
    found = diverge(trace(one), trace(two))
    assert found is not None
    assert (found.first, found.second) == values


def test_nothing_is_said_of_values_that_were_not_kept() -> None:
    other = trace({"a": 2})
    other.infos = [info_digest(b"{" + b" " * 40 + b"}")]
    assert str(diverge(trace({"a": 1}), other)) == "info differs at the reset"


def test_long_values_are_shown_where_they_differ() -> None:
    words = str(Divergence(3, "info", {"map": "." * 500 + "x" + "." * 500}, {"map": "." * 500 + "y" + "." * 500}))
    assert "x" in words
    assert "y" in words
    assert len(words) < 220
    assert str(Divergence(3, "info", "ab" + "." * 90, "cd")) == f"info differs at step 3 (ab{'.' * 78}..., then cd)"


def test_the_same_exception_at_another_step_reads_otherwise() -> None:
    one, two = trace({}), trace({})
    one.fault = two.fault = Fault("step", 1, "ValueError", "no")
    two.observations, two.infos, two.rewards = [b"0", b"1"], [b"{}", b"{}"], [1.0]
    two.terminated, two.truncated = [False], [False]
    assert str(diverge(one, two)).endswith("(ValueError: no after 0 steps, then ValueError: no after 1 step)")


def test_an_exception_of_any_name_has_a_digest() -> None:
    one, two = trace({}), trace({})
    one.fault, two.fault = Fault("step", 1, "\ud800"), Fault("step", 1, "\udfff")
    assert digest(one) != digest(two)


def test_success_is_not_compared_with_an_info_that_was_not_kept() -> None:
    info = b'{"is_success": false, "text": "' + b"x" * 40 + b'"}'
    one, other = trace({}), trace({})
    one.infos, other.infos = [info], [info_digest(info)]
    assert diverge(one, other) is None
    assert diverge(one, other, info=False) is None
    other.infos = [info.replace(b"false", b"true")]
    found = diverge(one, other, info=False)
    assert found is not None
    assert found.field == "success"
