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
    return {"type": type_name(space), "repr": repr(jsonable(space))}


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
    return value


def _bounds(values: Any) -> Any:
    """One number where all bounds are equal, else the flat list."""
    flat = np.asarray(values).ravel()
    if flat.size and (flat == flat[0]).all():
        return jsonable(flat[0].item())
    if flat.size > _MAX_BOUNDS:
        return None
    return [jsonable(item) for item in flat.tolist()]
