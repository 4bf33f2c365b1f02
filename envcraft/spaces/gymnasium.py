"""Between :class:`envcraft.spaces.spec.SpaceSpec` and Gymnasium's spaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from envcraft_protocol.spaces import describe
from gymnasium import spaces

from envcraft.errors import UsageError
from envcraft.spaces import spec
from envcraft.spaces.spec import Bound, Box, SpaceSpec, read_space


def from_gymnasium(space: spaces.Space[Any]) -> SpaceSpec:
    """The description of a space."""
    return read_space(describe(space))


def to_gymnasium(space: SpaceSpec, what: str) -> spaces.Space[Any]:
    """The space that a description describes.

    Args:
        what: what the error message calls the space.

    Raises:
        UsageError: a sandbox cannot exchange values of this space: of Sequence, Graph, OneOf, or an unknown type.
    """
    match space:
        case Box():
            dtype = np.dtype(space.dtype)
            low, high = (_limit(space, side, dtype) for side in ("low", "high"))
            return spaces.Box(low, high, space.shape, dtype.type)
        case spec.Discrete():
            return spaces.Discrete(space.n, start=space.start)
        case spec.MultiDiscrete():
            nvec, start = space.limits
            return spaces.MultiDiscrete(nvec, np.dtype(space.dtype).type, start=start)
        case spec.MultiBinary():
            return spaces.MultiBinary(space.shape if len(space.shape) > 1 else space.shape[0])
        case spec.Text():
            return spaces.Text(space.max_length, min_length=space.min_length, charset=space.charset)
        case spec.Dict():
            return spaces.Dict({name: to_gymnasium(item, what) for name, item in space.spaces})
        case spec.Tuple():
            return spaces.Tuple([to_gymnasium(item, what) for item in space.spaces])
    raise UsageError(f"{what} is {space}, which a sandboxed environment cannot have")


def _limit(space: Box, side: str, dtype: np.dtype[Any]) -> Any:
    """One side of a Box as an array of its dtype; the dtype's extreme if the worker sent no bounds."""
    bound: Bound = getattr(space, side)
    if isinstance(bound, tuple):
        return np.array(bound, dtype).reshape(space.shape)
    if bound is None and dtype.kind == "f":
        bound = -np.inf if side == "low" else np.inf
    elif bound is None:
        bound = getattr(np.iinfo(dtype), "min" if side == "low" else "max")
    return np.full(space.shape, bound, dtype)
