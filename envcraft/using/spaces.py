"""Between JSON descriptions of spaces, as :mod:`envcraft.spaces` has them, and Gymnasium's; and actions as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from envcraft import spaces as described
from envcraft.errors import UsageError


def to_gymnasium(space: described.Space, what: str) -> spaces.Space[Any]:
    """The space that a description is of. Raises UsageError, naming `what`, for kinds that cannot be sent to a sandbox:
    all but Box, Discrete, MultiDiscrete, MultiBinary, Text, and Dict and Tuple of these.
    """
    kind = space["type"]
    if kind == "Box":
        shape, dtype = tuple(space["shape"]), np.dtype(space["dtype"])
        low, high = (_side(space[side], shape, dtype, side) for side in ("low", "high"))
        return spaces.Box(low, high, shape, dtype.type)
    if kind == "Discrete":
        return spaces.Discrete(space["n"], start=space["start"])
    if kind == "MultiDiscrete":
        start = space.get("start")
        dtype = np.dtype(space.get("dtype", "int64"))
        return spaces.MultiDiscrete(
            np.array(space["nvec"]), dtype.type, start=None if start is None else np.array(start)
        )
    if kind == "MultiBinary":
        return spaces.MultiBinary(space["shape"] if len(space["shape"]) > 1 else space["shape"][0])
    if kind == "Text":
        return spaces.Text(space["max_length"], min_length=space["min_length"], charset=space["charset"])
    if kind == "Dict":
        return spaces.Dict({name: to_gymnasium(item, what) for name, item in space["spaces"]})
    if kind == "Tuple":
        return spaces.Tuple([to_gymnasium(item, what) for item in space["spaces"]])
    raise UsageError(f"{what} is {described.describe(space)}, which a sandboxed environment cannot have")


def _side(bound: Any, shape: tuple[int, ...], dtype: np.dtype[Any], side: str) -> Any:
    """One side of a Box in its own type; the extreme of that where the description was too long to be told."""
    if bound is not None:
        if isinstance(bound, list):
            return np.array([dtype.type(float(value)) for value in bound], dtype).reshape(shape)
        return np.full(shape, float(bound) if dtype.kind == "f" else int(bound), dtype)
    if dtype.kind == "f":
        return np.full(shape, -np.inf if side == "low" else np.inf, dtype)
    limits = np.iinfo(dtype)
    return np.full(shape, limits.min if side == "low" else limits.max, dtype)


def action_to_json(space: spaces.Space[Any], action: Any) -> Any:
    """An action as the worker reads it. Raises ValueError where it is not in the space."""
    if not space.contains(action):
        raise ValueError(f"the action {action!r} is not in {space}")
    return _plain(space, action)


def _plain(space: spaces.Space[Any], action: Any) -> Any:
    if isinstance(space, spaces.Dict):
        return {name: _plain(item, action[name]) for name, item in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return [_plain(item, part) for item, part in zip(space.spaces, action, strict=True)]
    if isinstance(space, spaces.Text):
        return action
    return np.asarray(action).tolist()
