"""Gymnasium spaces as JSON (:mod:`envcraft.spaces` reads it)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from .classes import type_name

_MAX_BOUNDS = 4096


def describe(space: Any) -> dict[str, Any]:
    """Give a space's JSON description."""
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


def _bounds(values: Any) -> Any:
    """One number where all bounds are equal, else the flat list."""
    flat = np.asarray(values).ravel()
    if flat.size and (flat == flat[0]).all():
        return _number(flat[0].item())
    if flat.size > _MAX_BOUNDS:
        return None
    return [_number(item) for item in flat.tolist()]


def _number(value: float) -> float | str:
    """As JSON has it: infinities, and integers of more than 64 bits, in words."""
    if isinstance(value, int):
        return value if -(2**63) <= value < 2**63 else str(value)
    return value if math.isfinite(value) else repr(value)
