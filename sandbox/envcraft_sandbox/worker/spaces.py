"""The host's JSON actions as the values that an agent would pass."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces


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
