"""Draw values of a space, as JSON. The stream of a seed never changes: ``--seed`` gives the same episodes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.random import Generator

from envcraft.spaces import spec
from envcraft.spaces.spec import Box, SpaceSpec

#: Integers that have no nearer bound are drawn up to this distance from zero.
_FAR = 2.0**62


def sample(space: SpaceSpec, rng: Generator) -> Any:
    """Draw one value as JSON: lists stand for arrays and tuples, and a graph is a dict of nodes, edges and links.

    Unbounded sides of a Box are drawn as Gymnasium does: normal, or exponential. Raises ValueError for a space that
    Gymnasium does not define.
    """
    match space:
        case spec.Discrete():
            return int(space.start + rng.integers(space.n))
        case spec.MultiDiscrete():
            nvec, start = space.limits
            return (rng.integers(np.zeros_like(nvec), nvec) + start).tolist()
        case spec.MultiBinary():
            return rng.integers(0, 2, space.shape).tolist()
        case Box():
            return _sample_box(space, rng)
        case spec.Text():
            length = int(rng.integers(space.min_length, space.max_length + 1))
            return "".join(rng.choice(list(space.charset)) for _ in range(length))
        case spec.Dict():
            return {name: sample(item, rng) for name, item in space.spaces}
        case spec.Tuple():
            return [sample(item, rng) for item in space.spaces]
        case spec.OneOf():
            index = int(rng.integers(len(space.spaces)))
            return [index, sample(space.spaces[index], rng)]
        case spec.Sequence():
            return [sample(space.space, rng) for _ in range(int(rng.geometric(0.25)))]
        case spec.Graph():
            return _sample_graph(space, rng)
    raise ValueError(f"cannot sample from {space}")


def enumerate_actions(space: SpaceSpec, most: int = 64) -> list[Any]:
    """Every value of a small discrete space, the all-zero one first; of a Box the middle and corners; else samples.

    Args:
        most: the highest number of values of a discrete space; of a larger space they are evenly spread.
    """
    rng = np.random.default_rng(0)
    match space:
        case spec.Discrete():
            return [space.start + number for number in range(min(space.n, most))]
        case spec.MultiDiscrete():
            nvec, start = space.limits
            bases = nvec.ravel().tolist()
            # In Python's integers: a few dozen parts have more joint actions than 64 bits can count.
            total = math.prod(bases)
            count = min(total, most)
            picks = [number * (total - 1) // max(count - 1, 1) for number in range(count)]
            return [(np.array(_digits(pick, bases)).reshape(nvec.shape) + start).tolist() for pick in picks]
        case spec.MultiBinary():
            ends = [np.zeros(space.shape, int).tolist(), np.ones(space.shape, int).tolist()]
            return ends + [sample(space, rng) for _ in range(min(most, 14))]
        case Box():
            return _corners(space)
    return [sample(space, rng) for _ in range(8)]


def _digits(number: int, bases: list[int]) -> list[int]:
    """A number in mixed radix, the most significant digit first."""
    digits = []
    for base in reversed(bases):
        number, digit = divmod(number, base)
        digits.append(digit)
    return digits[::-1]


def _corners(space: Box) -> list[Any]:
    """The middle, the lowest and the highest value, and the middle with one element low or high.

    Bounds beyond -1 or 1 count as -1 or 1.
    """
    low, high = space.arrays()
    low, high = np.clip(np.maximum(low, -1), low, high), np.clip(np.minimum(high, 1), low, high)
    middle = (low + high) / 2
    found = [middle.tolist(), low.tolist(), high.tolist()]
    for index in range(min(middle.size, 8)):
        for bound in (low, high):
            corner = middle.flatten()
            corner[index] = bound.ravel()[index]
            found.append(corner.reshape(space.shape).tolist())
    return found


def _sample_graph(space: spec.Graph, rng: Generator) -> Any:
    """Up to ten nodes, and up to ten edges: ``{"nodes": [...], "edges": [...] | None, "links": [...] | None}``."""
    nodes = [sample(space.nodes, rng) for _ in range(int(rng.integers(1, 11)))]
    if space.edges is None:
        return {"nodes": nodes, "edges": None, "links": None}
    links = rng.integers(0, len(nodes), (int(rng.integers(1, 11)), 2)).tolist()
    return {"nodes": nodes, "edges": [sample(space.edges, rng) for _ in links], "links": links}


def _sample_box(space: Box, rng: Generator) -> Any:
    low, high = space.arrays()
    if np.dtype(space.dtype).kind in "iub":
        # float64 rounds the limits of 64-bit integers to numbers beyond them.
        low, high = np.clip((low, high), -_FAR, _FAR).astype(np.int64)
        return rng.integers(low, high, endpoint=True).tolist()
    uniform = rng.random(space.shape)
    tail = rng.exponential(size=space.shape)
    normal = rng.normal(size=space.shape)
    below, above = np.isfinite(low), np.isfinite(high)
    bounded = np.where(below, low, 0) * (1 - uniform) + np.where(above, high, 0) * uniform
    value = np.where(below & above, bounded, np.where(below, low + tail, np.where(above, high - tail, normal)))
    return value.tolist()
