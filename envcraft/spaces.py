"""Gymnasium spaces as JSON descriptions: compare them, write them, sample from them.

The host builds nothing from the worker but these descriptions, and judges from them alone.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from numpy.random import Generator

from envcraft.errors import MalformedValue

Space = dict[str, Any]

_MAX_ELEMENTS = 8 * 1024 * 1024
_MAX_DEPTH = 8
#: So far from zero whole numbers are drawn that have no nearer bound.
_FAR = 2.0**62
#: The name of a type. What else NumPy reads as one it parses as Python, with errors of every kind.
_DTYPE = re.compile(r"[a-z]+[0-9]*")

#: The types that this module understands.
KNOWN = ("Box", "Discrete", "MultiDiscrete", "MultiBinary", "Text", "Dict", "Tuple", "Sequence", "Graph", "OneOf")


def check(space: Any, depth: int = 0) -> None:
    """See that a description which the worker sent has the form that this module reads. Raises MalformedValue."""
    if not isinstance(space, dict) or not isinstance(space.get("type"), str) or depth > _MAX_DEPTH:
        raise MalformedValue("a space without a type, or nested too deeply")
    kind = space["type"]
    if kind not in KNOWN:
        return
    try:
        _check(kind, space, depth)
    except MalformedValue:
        raise
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise MalformedValue(f"a space {kind} with {type(error).__name__}: {str(error)[:200]}") from None


def _check(kind: str, space: Space, depth: int) -> None:
    if kind == "Box":
        size = math.prod(_counts(space["shape"]))
        _known_dtype(space["dtype"])
        bounds = [_floats(bound) for bound in (space["low"], space["high"]) if bound is not None]
        if any(isinstance(space[side], list) and len(space[side]) != size for side in ("low", "high")):
            raise ValueError("bounds of another size")
        if len(bounds) == 2 and not np.all(np.array(bounds[0]) <= np.array(bounds[1])):
            raise ValueError("bounds that contradict each other")
    elif kind == "Discrete":
        if _whole(space["n"]) < 1 or abs(_whole(space["start"])) >= 2**62 or space["n"] >= 2**62:
            raise ValueError("no values")
    elif kind == "MultiDiscrete":
        _known_dtype(space.get("dtype", "int64"))
        nvec, start = (np.asarray(space[name], dtype=np.int64) for name in ("nvec", "start"))
        if nvec.size > _MAX_ELEMENTS or np.any(nvec < 1) or start.shape != nvec.shape:
            raise ValueError("no values, or starts of another shape")
    elif kind == "MultiBinary":
        _counts(space["shape"])
    elif kind == "Text":
        if not 0 <= _whole(space["min_length"]) <= _whole(space["max_length"]) <= _MAX_ELEMENTS:
            raise ValueError("lengths that contradict each other")
        if not isinstance(space["charset"], str) or not space["charset"]:
            raise ValueError("no characters")
    elif kind == "Sequence":
        if not isinstance(space["stack"], bool):
            raise TypeError("it is not told whether it is stacked")
        check(space["space"], depth + 1)
    elif kind == "Graph":
        check(space["nodes"], depth + 1)
        if space["edges"] is not None:
            check(space["edges"], depth + 1)
    else:
        if kind == "OneOf" and not space["spaces"]:
            raise ValueError("nothing to choose from")
        for item in space["spaces"]:
            if kind == "Dict" and not (isinstance(item, list) and len(item) == 2 and isinstance(item[0], str)):
                raise ValueError("a part without a name")
            check(item[1] if kind == "Dict" else item, depth + 1)


def _counts(shape: Any) -> list[int]:
    if not isinstance(shape, list) or len(shape) > 32 or math.prod(map(_whole, shape)) > _MAX_ELEMENTS:
        raise ValueError("no shape, or a huge one")
    if any(length < 0 for length in shape):
        raise ValueError("a negative length")
    return shape


def _whole(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise TypeError(f"{str(value)[:40]} is no whole number")
    return value


def _floats(bound: Any) -> list[float]:
    return [float(value) for value in (bound if isinstance(bound, list) else [bound])]


def _known_dtype(name: Any) -> None:
    if not isinstance(name, str) or not _DTYPE.fullmatch(name) or np.dtype(name).kind not in "biuf":
        raise ValueError(f"dtype {str(name)[:40]}")


def describe(space: Space, index: tuple[int, ...] = ()) -> str:
    """Write a space the way that Gymnasium prints it; with `index` a Box with the bounds that it has there."""
    kind = space["type"]
    if kind == "Box":
        low, high = (_bound(space[side], space["shape"], index) for side in ("low", "high"))
        return f"Box({low}, {high}, {tuple(space['shape'])}, {space['dtype']})"
    if kind == "MultiDiscrete":
        return f"MultiDiscrete({space['nvec']})"
    if kind == "Discrete":
        return f"Discrete({space['n']})" if not space["start"] else f"Discrete({space['n']}, start={space['start']})"
    if kind == "Dict":
        return "Dict(" + ", ".join(f"{name}: {describe(item)}" for name, item in space["spaces"]) + ")"
    if kind in ("Tuple", "OneOf"):
        return f"{kind}(" + ", ".join(describe(item) for item in space["spaces"]) + ")"
    if kind == "Sequence":
        return f"Sequence({describe(space['space'])}, stack={space['stack']})"
    if kind == "Graph":
        return f"Graph({describe(space['nodes'])}, {describe(space['edges']) if space['edges'] else None})"
    return str(kind)


def known(space: Space) -> bool:
    """Whether this module understands a space and all that is in it; packages make kinds of their own."""
    if space["type"] not in KNOWN:
        return False
    inner = [item[1] for item in space["spaces"]] if space["type"] == "Dict" else list(space.get("spaces", ()))
    inner += [space[name] for name in ("space", "nodes", "edges") if space.get(name)]
    return all(known(item) for item in inner)


def same(promised: Space, given: Space) -> bool:
    """Whether two descriptions mean the same space, bounds included."""
    kind = promised["type"]
    if kind != given["type"]:
        return False
    if kind == "Dict":
        one, two = dict(promised["spaces"]), dict(given["spaces"])
        return set(one) == set(two) and all(same(one[name], two[name]) for name in one)
    if kind in ("Tuple", "OneOf"):
        pairs = zip(promised["spaces"], given["spaces"], strict=False)
        return len(promised["spaces"]) == len(given["spaces"]) and all(same(one, two) for one, two in pairs)
    names = {"Box": ("shape", "dtype"), "MultiDiscrete": ("nvec", "start")}.get(kind, ())
    if any(promised.get(name) != given.get(name) for name in names):
        return False
    if kind == "Box":
        return all(_number(promised[name]) == _number(given[name]) for name in ("low", "high"))
    return kind == "MultiDiscrete" or promised == given


def sample(space: Space, rng: Generator) -> Any:
    """Draw a value as JSON. Unbounded sides of a Box are drawn as Gymnasium does: normal, or exponential."""
    kind = space["type"]
    if kind == "Discrete":
        return int(space["start"] + rng.integers(space["n"]))
    if kind == "MultiDiscrete":
        nvec = np.asarray(space["nvec"])
        return (rng.integers(np.zeros_like(nvec), nvec) + np.asarray(space.get("start", 0))).tolist()
    if kind == "MultiBinary":
        return rng.integers(0, 2, space["shape"]).tolist()
    if kind == "Box":
        return _sample_box(space, rng)
    if kind == "Text":
        length = int(rng.integers(space["min_length"], space["max_length"] + 1))
        return "".join(rng.choice(list(space["charset"])) for _ in range(length))
    if kind == "Dict":
        return {name: sample(item, rng) for name, item in space["spaces"]}
    if kind == "Tuple":
        return [sample(item, rng) for item in space["spaces"]]
    if kind == "OneOf":
        index = int(rng.integers(len(space["spaces"])))
        return [index, sample(space["spaces"][index], rng)]
    if kind == "Sequence":
        return [sample(space["space"], rng) for _ in range(int(rng.geometric(0.25)))]
    if kind == "Graph":
        return _sample_graph(space, rng)
    raise ValueError(f"cannot sample from {kind}")


def enumerate_actions(space: Space, most: int = 64) -> list[Any]:
    """Every value of a small discrete space, the all-zero one first; of any other, corners and the middle."""
    kind = space["type"]
    if kind == "Discrete":
        return [space["start"] + number for number in range(min(space["n"], most))]
    if kind == "MultiDiscrete":
        nvec = np.asarray(space["nvec"])
        start = np.asarray(space.get("start", np.zeros_like(nvec)))
        flat = nvec.ravel().tolist()
        # In Python's numbers: of a few dozen parts there are more joint actions than NumPy can count.
        total = math.prod(flat)
        count = min(total, most)
        picks = [number * (total - 1) // max(count - 1, 1) for number in range(count)]
        return [(np.array(_digits(pick, flat)).reshape(nvec.shape) + start).tolist() for pick in picks]
    if kind == "MultiBinary":
        rng = np.random.default_rng(0)
        return [np.zeros(space["shape"], int).tolist(), np.ones(space["shape"], int).tolist()] + [
            sample(space, rng) for _ in range(min(most, 14))
        ]
    if kind == "Box":
        shape = tuple(space["shape"])
        low, high = _moderate(space)
        ends = [((low + high) / 2).tolist(), low.tolist(), high.tolist()]
        flat_size = math.prod(shape)
        for index in range(min(flat_size, 8)):
            for bound in (low, high):
                corner = ((low + high) / 2).ravel()
                corner[index] = bound.ravel()[index]
                ends.append(corner.reshape(shape).tolist())
        return ends
    rng = np.random.default_rng(0)
    return [sample(space, rng) for _ in range(8)]


def _digits(number: int, bases: list[int]) -> list[int]:
    """A number as digits, each of a base of its own, the last one first to change."""
    digits = []
    for base in reversed(bases):
        number, digit = divmod(number, base)
        digits.append(digit)
    return digits[::-1]


def _moderate(space: Space) -> tuple[Any, Any]:
    """The bounds of a Box, each brought to -1 or 1 where the box goes that far."""
    low, high = (bounds(space[name], tuple(space["shape"])) for name in ("low", "high"))
    return np.clip(np.maximum(low, -1), low, high), np.clip(np.minimum(high, 1), low, high)


def _sample_graph(space: Space, rng: Generator) -> Any:
    """Up to ten nodes, and as many edges: ``{"nodes": [...], "edges": [...] | None, "links": [...] | None}``."""
    nodes = [sample(space["nodes"], rng) for _ in range(int(rng.integers(1, 11)))]
    if space["edges"] is None:
        return {"nodes": nodes, "edges": None, "links": None}
    links = rng.integers(0, len(nodes), (int(rng.integers(1, 11)), 2)).tolist()
    return {"nodes": nodes, "edges": [sample(space["edges"], rng) for _ in links], "links": links}


def _bound(bound: Any, shape: list[int], index: tuple[int, ...]) -> str:
    if not isinstance(bound, list) or not bound:
        return str(bound)
    return str(bound[int(np.ravel_multi_index(index, tuple(shape)))]) if index else f"{bound[0]}…"


def _sample_box(space: Space, rng: Generator) -> Any:
    shape = tuple(space["shape"])
    low, high = bounds(space["low"], shape), bounds(space["high"], shape)
    if np.dtype(space["dtype"]).kind in "iub":
        # A float holds the ends of 64 bits as numbers beyond them.
        low, high = np.clip((low, high), -_FAR, _FAR).astype(np.int64)
        return rng.integers(low, high, endpoint=True).tolist()
    uniform = rng.random(shape)
    tail = rng.exponential(size=shape)
    normal = rng.normal(size=shape)
    below, above = np.isfinite(low), np.isfinite(high)
    bounded = np.where(below, low, 0) * (1 - uniform) + np.where(above, high, 0) * uniform
    value = np.where(below & above, bounded, np.where(below, low + tail, np.where(above, high - tail, normal)))
    return value.tolist()


def bounds(bound: Any, shape: tuple[int, ...]) -> Any:
    """One side of a Box as an array."""
    if isinstance(bound, list):
        return np.array([_number(value) for value in bound], dtype=np.float64).reshape(shape)
    return np.full(shape, _number(bound), dtype=np.float64)


def _number(value: Any) -> Any:
    return [_number(item) for item in value] if isinstance(value, list) else None if value is None else float(value)
