"""Gymnasium spaces as JSON descriptions: sample from them, and say what is wrong with a value.

The host builds nothing from the worker but these descriptions, and judges from them alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.random import Generator

Space = dict[str, Any]

#: The types that this module understands.
KNOWN = ("Box", "Discrete", "MultiDiscrete", "MultiBinary", "Text", "Dict", "Tuple")


def describe(space: Space) -> str:
    """Write a space the way that Gymnasium prints it."""
    kind = space["type"]
    if kind == "Box":
        low, high = (
            value if not isinstance(value, list) else f"{value[0]}…" for value in (space["low"], space["high"])
        )
        return f"Box({low}, {high}, {tuple(space['shape'])}, {space['dtype']})"
    if kind == "MultiDiscrete":
        return f"MultiDiscrete({space['nvec']})"
    if kind == "Discrete":
        return f"Discrete({space['n']})"
    if kind == "Dict":
        return "Dict(" + ", ".join(f"{name}: {describe(item)}" for name, item in space["spaces"]) + ")"
    if kind == "Tuple":
        return "Tuple(" + ", ".join(describe(item) for item in space["spaces"]) + ")"
    return str(kind)


def same(promised: Space, given: Space) -> bool:
    """Whether two descriptions mean the same space, bounds included."""
    if promised["type"] != given["type"]:
        return False
    names = {"Box": ("shape", "dtype"), "MultiDiscrete": ("nvec", "start")}.get(promised["type"], ())
    if any(promised.get(name) != given.get(name) for name in names):
        return False
    if promised["type"] == "Box":
        return all(_number(promised[name]) == _number(given[name]) for name in ("low", "high"))
    return promised["type"] in ("Box", "MultiDiscrete") or promised == given


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
    raise ValueError(f"cannot sample from {kind}")


def enumerate_actions(space: Space, most: int = 64) -> list[Any]:
    """Every value of a small discrete space, the all-zero one first; of any other, corners and the middle."""
    kind = space["type"]
    if kind == "Discrete":
        return [space["start"] + number for number in range(min(space["n"], most))]
    if kind == "MultiDiscrete":
        nvec = np.asarray(space["nvec"])
        start = np.asarray(space.get("start", np.zeros_like(nvec)))
        total = math.prod(nvec.ravel().tolist())
        picks = range(total) if total <= most else np.linspace(0, total - 1, most).astype(int).tolist()
        flat = nvec.ravel()
        return [(np.array(np.unravel_index(pick, flat)).reshape(nvec.shape) + start).tolist() for pick in picks]
    if kind == "MultiBinary":
        rng = np.random.default_rng(0)
        return [np.zeros(space["shape"], int).tolist(), np.ones(space["shape"], int).tolist()] + [
            sample(space, rng) for _ in range(min(most, 14))
        ]
    if kind == "Box":
        shape = tuple(space["shape"])
        low, high = (np.clip(_array(space[name], shape), -1, 1) for name in ("low", "high"))
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


def problem(space: Space, value: Any, path: str = "") -> tuple[str, str] | None:
    """Say what is wrong with a value: ``("type" | "range", words)``, or None.

    Types, shapes and keys give ``type``; a NaN or a number outside the bounds gives ``range``, with its index.
    """
    kind = space["type"]
    if kind == "Box":
        return _box_problem(space, value, path)
    if kind == "Discrete":
        if isinstance(value, np.ndarray) and value.ndim == 0:
            value = value[()]
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            return "type", f"{path or 'the observation'} is {_named(value)}, not an integer"
        if not space["start"] <= value < space["start"] + space["n"]:
            return "range", f"{path or 'the observation'} is {value}, outside {describe(space)}"
        return None
    if kind in ("MultiDiscrete", "MultiBinary"):
        shape = np.shape(space["nvec"]) if kind == "MultiDiscrete" else tuple(space["shape"])
        if not isinstance(value, np.ndarray) or value.shape != shape or value.dtype.kind not in "iub":
            return "type", f"{path or 'the observation'} is {_named(value)}, not an integer array of shape {shape}"
        start = np.asarray(space.get("start", 0)) if kind == "MultiDiscrete" else 0
        top = start + (np.asarray(space["nvec"]) if kind == "MultiDiscrete" else 2)
        return _first_outside((value >= start) & (value < top), value, space, path)
    if kind == "Text":
        if not isinstance(value, str):
            return "type", f"{path or 'the observation'} is {_named(value)}, not a str"
        odd = set(value) - set(space["charset"])
        if odd or not space["min_length"] <= len(value) <= space["max_length"]:
            return "range", f"{path or 'the observation'} is a text of {len(value)} characters outside its space"
        return None
    if kind in ("Dict", "Tuple"):
        return _nested_problem(space, value, path)
    return None


def _sample_box(space: Space, rng: Generator) -> Any:
    shape = tuple(space["shape"])
    low, high = _array(space["low"], shape), _array(space["high"], shape)
    if np.dtype(space["dtype"]).kind in "iub":
        return rng.integers(low.astype(np.int64), high.astype(np.int64), endpoint=True).tolist()
    uniform = rng.random(shape)
    tail = rng.exponential(size=shape)
    normal = rng.normal(size=shape)
    below, above = np.isfinite(low), np.isfinite(high)
    bounded = np.where(below, low, 0) * (1 - uniform) + np.where(above, high, 0) * uniform
    value = np.where(below & above, bounded, np.where(below, low + tail, np.where(above, high - tail, normal)))
    return value.tolist()


def _box_problem(space: Space, value: Any, path: str) -> tuple[str, str] | None:
    shape, dtype = tuple(space["shape"]), np.dtype(space["dtype"])
    if isinstance(value, np.generic) and shape == ():
        value = np.asarray(value)
    if not isinstance(value, np.ndarray):
        return "type", f"{path or 'the observation'} is {_named(value)}, not an array"
    if value.shape != shape:
        return "type", f"{path or 'the observation'} has shape {value.shape}, not {shape}"
    if value.dtype != dtype:
        return "type", f"{path or 'the observation'} has dtype {value.dtype}, not {dtype}"
    if space["low"] is None or space["high"] is None:
        return None
    low, high = _array(space["low"], shape), _array(space["high"], shape)
    return _first_outside((value >= low) & (value <= high), value, space, path)


def _first_outside(inside: Any, value: Any, space: Space, path: str) -> tuple[str, str] | None:
    if np.all(inside):
        return None
    index = tuple(int(number) for number in np.argwhere(~np.asarray(inside))[0])
    where = f"{path or 'observation'}[{', '.join(map(str, index))}]" if index else path or "the observation"
    return "range", f"{where} is {value[index]}, outside {describe(space)}"


def _nested_problem(space: Space, value: Any, path: str) -> tuple[str, str] | None:
    if space["type"] == "Dict":
        if not isinstance(value, dict):
            return "type", f"{path or 'the observation'} is {_named(value)}, not a dict"
        expected = {name for name, _ in space["spaces"]}
        if set(value) != expected:
            return "type", f"{path or 'the observation'} has the keys {sorted(value)}, not {sorted(expected)}"
        pairs = [(name, item, value[name]) for name, item in space["spaces"]]
    else:
        if not isinstance(value, tuple) or len(value) != len(space["spaces"]):
            return "type", f"{path or 'the observation'} is {_named(value)}, not a tuple of {len(space['spaces'])}"
        pairs = [(str(index), item, value[index]) for index, item in enumerate(space["spaces"])]
    for name, item, part in pairs:
        if found := problem(item, part, f"{path or 'observation'}[{name}]"):
            return found
    return None


def _array(bound: Any, shape: tuple[int, ...]) -> Any:
    if isinstance(bound, list):
        return np.array([_number(value) for value in bound], dtype=np.float64).reshape(shape)
    return np.full(shape, _number(bound), dtype=np.float64)


def _number(value: Any) -> Any:
    return [_number(item) for item in value] if isinstance(value, list) else None if value is None else float(value)


def _named(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"a {value.dtype} array of shape {value.shape}"
    return "None" if value is None else f"a {type(value).__name__}"
