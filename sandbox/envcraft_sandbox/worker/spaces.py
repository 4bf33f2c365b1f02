"""Gymnasium spaces as JSON for the host, and the host's JSON actions as the arrays an agent would pass."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from .channel import jsonable, type_name

_MAX_BOUNDS = 4096


def describe(space: Any) -> dict[str, Any]:
    """Give a space's JSON description (:mod:`envcraft.spaces` reads it)."""
    if isinstance(space, spaces.Box):
        return {
            "type": "Box",
            "low": _bounds(space.low),
            "high": _bounds(space.high),
            "shape": list(space.shape),
            "dtype": str(space.dtype),
        }
    if isinstance(space, spaces.Discrete):
        return {"type": "Discrete", "n": int(space.n), "start": int(space.start)}
    if isinstance(space, spaces.MultiDiscrete):
        return {
            "type": "MultiDiscrete",
            "nvec": space.nvec.tolist(),
            "start": np.asarray(getattr(space, "start", np.zeros_like(space.nvec))).tolist(),
            "dtype": str(space.dtype),
        }
    if isinstance(space, spaces.MultiBinary):
        return {"type": "MultiBinary", "shape": list(space.shape)}
    if isinstance(space, spaces.Text):
        return {
            "type": "Text",
            "min_length": space.min_length,
            "max_length": space.max_length,
            "charset": "".join(sorted(space.character_set)),
        }
    if isinstance(space, spaces.Dict):
        return {"type": "Dict", "spaces": [[str(key), describe(item)] for key, item in space.spaces.items()]}
    if isinstance(space, spaces.Tuple):
        return {"type": "Tuple", "spaces": [describe(item) for item in space.spaces]}
    if isinstance(space, spaces.Sequence):
        return {"type": "Sequence", "space": describe(space.feature_space), "stack": bool(space.stack)}
    if isinstance(space, spaces.Graph):
        edges = None if space.edge_space is None else describe(space.edge_space)
        return {"type": "Graph", "nodes": describe(space.node_space), "edges": edges}
    if isinstance(space, spaces.OneOf):
        return {"type": "OneOf", "spaces": [describe(item) for item in space.spaces]}
    return {"type": type_name(space), "custom": isinstance(space, spaces.Space)}


def action(spec: dict[str, Any], value: Any) -> Any:
    """Build the value that an agent would pass to ``step`` from the host's JSON."""
    kind = spec["type"]
    if kind == "Discrete":
        return np.int64(value)
    if kind == "MultiDiscrete":
        return np.array(value, dtype=spec.get("dtype", "int64"))
    if kind == "MultiBinary":
        return np.array(value, dtype=np.int8)
    if kind == "Box":
        return np.array(value, dtype=spec["dtype"]).reshape(spec["shape"])
    if kind == "Dict":
        return {key: action(item, value[key]) for key, item in spec["spaces"]}
    if kind == "Tuple":
        return tuple(action(item, part) for item, part in zip(spec["spaces"], value, strict=True))
    if kind == "OneOf":
        return np.int64(value[0]), action(spec["spaces"][value[0]], value[1])
    if kind == "Sequence":
        items = tuple(action(spec["space"], item) for item in value)
        return _stack(spec["space"], items) if spec["stack"] else items
    if kind == "Graph":
        return spaces.GraphInstance(
            _stack(spec["nodes"], [action(spec["nodes"], item) for item in value["nodes"]]),
            None
            if value["edges"] is None
            else _stack(spec["edges"], [action(spec["edges"], x) for x in value["edges"]]),
            None if value["links"] is None else np.array(value["links"], dtype=np.int32),
        )
    return value


def _stack(spec: dict[str, Any], items: Any) -> Any:
    """Values of one space as Gymnasium batches them."""
    if spec["type"] == "Dict":
        return {key: _stack(item, [value[key] for value in items]) for key, item in spec["spaces"]}
    if spec["type"] == "Tuple":
        return tuple(_stack(item, [value[at] for value in items]) for at, item in enumerate(spec["spaces"]))
    if spec["type"] in ("Box", "Discrete", "MultiDiscrete", "MultiBinary"):
        return np.stack(items)
    return tuple(items)


def _bounds(values: Any) -> Any:
    """One number where all bounds are equal, else the flat list."""
    flat = np.asarray(values).ravel()
    if flat.size and (flat == flat[0]).all():
        return jsonable(flat[0].item())
    if flat.size > _MAX_BOUNDS:
        return None
    return [jsonable(item) for item in flat.tolist()]
