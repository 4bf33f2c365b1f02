"""Gymnasium's spaces and their values to and from JSON (:mod:`envcraft.spaces.spec` reads the spaces)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from .classes import type_name

_MAX_BOUNDS = 4096
#: How integers of an action are passed: with the type of the space, as int32, or as Python's ints and lists.
Form = Literal["own", "int32", "python"]


def describe(space: Any) -> dict[str, Any]:
    """The JSON description of a space."""
    match space:
        case spaces.Box():
            low, high = _bounds(space.low), _bounds(space.high)
            return {"type": "Box", "low": low, "high": high, "shape": list(space.shape), "dtype": str(space.dtype)}
        case spaces.Discrete():
            return {"type": "Discrete", "n": int(space.n), "start": int(space.start)}
        case spaces.MultiDiscrete():
            start = np.asarray(getattr(space, "start", np.zeros_like(space.nvec))).tolist()
            return {
                "type": "MultiDiscrete",
                "nvec": space.nvec.tolist(),
                "start": start,
                "dtype": str(space.dtype),
            }
        case spaces.MultiBinary():
            return {"type": "MultiBinary", "shape": list(space.shape)}
        case spaces.Text():
            lengths = {"min_length": space.min_length, "max_length": space.max_length}
            return {"type": "Text", **lengths, "charset": "".join(sorted(space.character_set))}
        case spaces.Dict():
            return {"type": "Dict", "spaces": [[str(key), describe(item)] for key, item in space.spaces.items()]}
        case spaces.Tuple():
            return {"type": "Tuple", "spaces": [describe(item) for item in space.spaces]}
        case spaces.Sequence():
            return {"type": "Sequence", "space": describe(space.feature_space), "stack": bool(space.stack)}
        case spaces.Graph():
            edges = None if space.edge_space is None else describe(space.edge_space)
            return {"type": "Graph", "nodes": describe(space.node_space), "edges": edges}
        case spaces.OneOf():
            return {"type": "OneOf", "spaces": [describe(item) for item in space.spaces]}
    return {"type": type_name(space), "custom": isinstance(space, spaces.Space)}


def _bounds(values: Any) -> Any:
    """One number if all bounds are equal, else the flat list; None if there are too many."""
    flat = np.asarray(values).ravel()
    if flat.size and (flat == flat[0]).all():
        return _number(flat[0].item())
    if flat.size > _MAX_BOUNDS:
        return None
    return [_number(item) for item in flat.tolist()]


def _number(value: float) -> float | str:
    """A number for JSON: infinities, and integers of more than 64 bits, become strings."""
    if isinstance(value, int):
        # The bounds of a Box of bool are bools.
        return int(value) if -(2**63) <= value < 2**63 else str(value)
    return value if math.isfinite(value) else repr(value)


def encode_action(space: spaces.Space[Any], action: Any) -> Any:
    """The JSON of an action.

    Raises:
        ValueError: the action is not in the space.
    """
    if not space.contains(action):
        raise ValueError(f"the action {action!r} is not in {space}")
    return _encode(space, action)


def _encode(space: spaces.Space[Any], action: Any) -> Any:
    match space:
        case spaces.Dict():
            return {name: _encode(item, action[name]) for name, item in space.spaces.items()}
        case spaces.Tuple():
            return [_encode(item, part) for item, part in zip(space.spaces, action, strict=True)]
        case spaces.Text():
            return action
    return np.asarray(action).tolist()


def decode_action(spec: dict[str, Any], action: Any, form: Form = "own") -> Any:
    """The value that an agent passes to ``step``.

    Args:
        spec: the JSON description of the action space.
        action: JSON, as the host draws it.
        form: of the integers, also of those in dictionaries and tuples.
    """
    match spec["type"]:
        case "Discrete":
            return int(action) if form == "python" else _integers(action, np.int64, form)[()]
        case "MultiDiscrete":
            return _integers(action, np.dtype(spec.get("dtype", "int64")), form)
        case "MultiBinary":
            return _integers(action, np.int8, form)
        case "Box":
            return np.array(action, dtype=spec["dtype"]).reshape(spec["shape"])
        case "Dict":
            return {name: decode_action(item, action[name], form) for name, item in spec["spaces"]}
        case "Tuple":
            return tuple(decode_action(item, part, form) for item, part in zip(spec["spaces"], action, strict=True))
        case "OneOf":
            return np.int64(action[0]), decode_action(spec["spaces"][action[0]], action[1])
        case "Sequence":
            items = tuple(decode_action(spec["space"], item) for item in action)
            return _stack(spec["space"], items) if spec["stack"] else items
        case "Graph":
            links = None if action["links"] is None else np.array(action["links"], dtype=np.int32)
            nodes, edges = (_decode_all(spec[part], action[part]) for part in ("nodes", "edges"))
            return spaces.GraphInstance(nodes, edges, links)
    return action


def _integers(values: Any, own: Any, form: Form) -> Any:
    array = np.array(values, dtype=own)
    if form == "python":
        return array.tolist()
    return array.astype(np.int32) if form == "int32" and np.array_equal(array, array.astype(np.int32)) else array


def _decode_all(spec: dict[str, Any], items: list[Any] | None) -> Any:
    return None if items is None else _stack(spec, [decode_action(spec, item) for item in items])


def _stack(spec: dict[str, Any], items: Sequence[Any]) -> Any:
    """Values of one space in the batch that Gymnasium makes of them."""
    match spec["type"]:
        case "Dict":
            return {name: _stack(item, [value[name] for value in items]) for name, item in spec["spaces"]}
        case "Tuple":
            return tuple(_stack(item, [value[at] for value in items]) for at, item in enumerate(spec["spaces"]))
        case "Box" | "Discrete" | "MultiDiscrete" | "MultiBinary":
            return np.stack(items)
    return tuple(items)
