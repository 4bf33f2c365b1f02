"""Whether a value lies in a space, judged on this side from the space's description and the value's own bytes."""

from __future__ import annotations

from typing import Any

import numpy as np

from envcraft.spaces import Space, bounds, describe

#: What a bound may be exceeded by where an environment made its own space: rounding, as a share of the bound.
_ROUNDING = 1e-5

Problem = tuple[str, str]


def problem(space: Space, value: Any, path: str = "", exact: bool = True) -> Problem | None:
    """Say what is wrong with a value: ``("type" | "range", words)``, or None.

    Types, shapes and keys give ``type``; a NaN or a number outside the bounds gives ``range``, with its index.

    A contract's space is `exact`. Otherwise this asks what ``space.contains`` does: a dtype that casts safely is as
    good, and so is a list in place of a tuple, or a list or number in place of an array; and numbers may be off by
    rounding.
    """
    kind = space["type"]
    if kind == "Box":
        return _box(space, value, path, exact)
    if kind == "Discrete":
        return _discrete(space, value, path, exact)
    if kind in ("MultiDiscrete", "MultiBinary"):
        return _integers(space, value, path, exact)
    if kind == "Text":
        return _text(space, value, path)
    if kind == "Dict":
        return _dict(space, value, path, exact)
    if kind == "Tuple":
        return _tuple(space, value, path, exact)
    if kind == "OneOf":
        return _one_of(space, value, path, exact)
    if kind == "Sequence":
        return _sequence(space, value, path, exact)
    if kind == "Graph":
        return _graph(space, value, path, exact)
    return None


def refuse(space: Space, action: Any) -> str:
    """Say why an action, as JSON, is not in the space, or nothing."""
    try:
        found = _action(space, action, "the action")
    except (ValueError, TypeError, OverflowError):
        return f"the action {str(action)[:80]} is not in {describe(space)}"
    return f"{found[1]}, in {describe(space)}" if found else ""


def _action(space: Space, action: Any, path: str) -> Problem | None:
    """What is wrong with an action as :func:`envcraft.spaces.sample` writes it: lists stand for arrays and tuples."""
    kind = space["type"]
    if kind == "Box":
        with np.errstate(over="ignore"):
            return problem(space, np.asarray(action, dtype=space["dtype"]), path)
    if kind in ("MultiDiscrete", "MultiBinary"):
        return problem(space, np.asarray(action), path)
    parts = _action_parts(space, action)
    if parts is None:
        return problem(space, action, path)
    for name, item, part in parts:
        if found := _action(item, part, f"{path}[{name}]"):
            return found
    return None


def _action_parts(space: Space, action: Any) -> list[tuple[str, Space, Any]] | None:
    """The parts of an action in a space that is made of spaces; None where it has not got them."""
    kind = space["type"]
    if kind == "Dict" and isinstance(action, dict) and set(action) == {name for name, _ in space["spaces"]}:
        return [(name, item, action[name]) for name, item in space["spaces"]]
    if kind == "Graph" and isinstance(action, dict) and set(action) == {"nodes", "edges", "links"}:
        return _graph_parts(space, **action)
    if not isinstance(action, list):
        return None
    if kind == "Tuple" and len(action) == len(space["spaces"]):
        return [
            (str(index), item, part) for index, (item, part) in enumerate(zip(space["spaces"], action, strict=True))
        ]
    if kind == "Sequence":
        return [(str(index), space["space"], part) for index, part in enumerate(action)]
    if kind == "OneOf" and len(action) == 2 and _is_index(action[0], space["spaces"]):
        return [("1", space["spaces"][action[0]], action[1])]
    return None


def _graph_parts(space: Space, nodes: Any, edges: Any, links: Any) -> list[tuple[str, Space, Any]] | None:
    if not isinstance(nodes, list):
        return None
    parts = [(f"nodes, {index}", space["nodes"], node) for index, node in enumerate(nodes)]
    if edges is None and links is None:
        return parts
    if space["edges"] is None or not isinstance(edges, list) or not isinstance(links, list) or len(edges) != len(links):
        return None
    if not all(
        isinstance(ends, list) and len(ends) == 2 and all(_is_index(end, nodes) for end in ends) for ends in links
    ):
        return None
    return [*parts, *((f"edges, {index}", space["edges"], edge) for index, edge in enumerate(edges))]


def _is_index(number: Any, items: list[Any]) -> bool:
    return isinstance(number, int) and not isinstance(number, bool) and 0 <= number < len(items)


def _box(space: Space, value: Any, path: str, exact: bool) -> Problem | None:
    shape, dtype = tuple(space["shape"]), np.dtype(space["dtype"])
    if isinstance(value, np.generic) and shape == ():
        value = np.asarray(value)
    if not exact and isinstance(value, bool | int | float | list | tuple):
        value = _array(value, dtype)
    if not isinstance(value, np.ndarray):
        return _wrong(path, f"is {_named(value)}, not an array")
    if value.shape != shape:
        return _wrong(path, f"has shape {value.shape}, not {shape}")
    if value.dtype != dtype and (exact or not np.can_cast(value.dtype, dtype)):
        return _wrong(path, f"has dtype {value.dtype}, not {dtype}")
    if space["low"] is None or space["high"] is None:
        return None
    low, high = bounds(space["low"], shape), bounds(space["high"], shape)
    if not exact and dtype.kind == "f":
        low = low - _ROUNDING * np.maximum(1, np.abs(low))
        high = high + _ROUNDING * np.maximum(1, np.abs(high))
    return _first_outside((value >= low) & (value <= high), value, space, path)


def _array(value: Any, dtype: np.dtype[Any] | None = None) -> Any:
    """As ``contains`` reads numbers and lists; what is no array of numbers as it is."""
    try:
        with np.errstate(all="ignore"):
            made = np.asarray(value, dtype)
    except (ValueError, TypeError, OverflowError):
        return value
    return made if made.dtype.kind in "biuf" else value


def _discrete(space: Space, value: Any, path: str, exact: bool) -> Problem | None:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if (exact and isinstance(value, bool)) or not isinstance(value, int | np.integer):
        return _wrong(path, f"is {_named(value)}, not an integer")
    if not space["start"] <= value < space["start"] + space["n"]:
        return _outside(path, f"is {value}, outside {describe(space)}")
    return None


def _integers(space: Space, value: Any, path: str, exact: bool) -> Problem | None:
    several = space["type"] == "MultiDiscrete"
    shape = np.shape(space["nvec"]) if several else tuple(space["shape"])
    if not exact and isinstance(value, list | tuple):
        value = _array(value)
    if (
        not isinstance(value, np.ndarray)
        or value.shape != shape
        or value.dtype.kind not in ("iub" if exact else "iubf")
    ):
        return _wrong(path, f"is {_named(value)}, not an integer array of shape {shape}")
    start = np.asarray(space.get("start", 0)) if several else 0
    top = start + (np.asarray(space["nvec"]) if several else 2)
    inside = (value >= start) & (value < top)
    if not several and value.dtype.kind == "f":
        inside &= value == np.rint(value)
    return _first_outside(inside, value, space, path)


def _text(space: Space, value: Any, path: str) -> Problem | None:
    if not isinstance(value, str):
        return _wrong(path, f"is {_named(value)}, not a str")
    odd = set(value) - set(space["charset"])
    if odd or not space["min_length"] <= len(value) <= space["max_length"]:
        return _outside(path, f"is a text of {len(value)} characters outside its space")
    return None


def _dict(space: Space, value: Any, path: str, exact: bool) -> Problem | None:
    if not isinstance(value, dict):
        return _wrong(path, f"is {_named(value)}, not a dict")
    expected = {name for name, _ in space["spaces"]}
    if set(value) != expected:
        return _wrong(path, f"has the keys {sorted(value)}, not {sorted(expected)}")
    return _parts([(name, item, value[name]) for name, item in space["spaces"]], path, exact)


def _tuple(space: Space, value: Any, path: str, exact: bool) -> Problem | None:
    parts = list(value) if isinstance(value, list | np.ndarray) and not exact else value
    if not isinstance(parts, tuple | list if not exact else tuple) or len(parts) != len(space["spaces"]):
        return _wrong(path, f"is {_named(value)}, not a tuple of {len(space['spaces'])}")
    pairs = zip(space["spaces"], parts, strict=True)
    return _parts([(str(index), item, part) for index, (item, part) in enumerate(pairs)], path, exact)


def _one_of(space: Space, value: Any, path: str, exact: bool) -> Problem | None:
    if not isinstance(value, tuple) or len(value) != 2 or not isinstance(value[0], int | np.integer):
        return _wrong(path, f"is {_named(value)}, not a tuple of a number and a value")
    if not 0 <= value[0] < len(space["spaces"]):
        return _outside(path, f"chooses space {value[0]} of {len(space['spaces'])}")
    return problem(space["spaces"][int(value[0])], value[1], f"{path or 'observation'}[1]", exact)


def _sequence(space: Space, value: Any, path: str, exact: bool) -> Problem | None:
    rows = _rows(value) if space["stack"] else value
    if not isinstance(rows, list if space["stack"] else tuple):
        what = "stacked values" if space["stack"] else "a tuple"
        return _wrong(path, f"is {_named(value)}, not {what}")
    return _parts([(str(index), space["space"], row) for index, row in enumerate(rows)], path, exact)


def _graph(space: Space, value: Any, path: str, exact: bool) -> Problem | None:
    if not isinstance(value, tuple) or len(value) != 3 or not _is_rows(value[0]):
        return _wrong(path, f"is {_named(value)}, not a GraphInstance of nodes, edges and edge_links")
    nodes, edges, links = value
    where = path or "observation"
    if found := _parts([(str(n), space["nodes"], node) for n, node in enumerate(nodes)], f"{where}.nodes", exact):
        return found
    if links is None:
        return None if edges is None else _wrong(path, "has edges and no edge_links")
    if not isinstance(links, np.ndarray) or links.dtype.kind not in "iu" or links.shape[1:] != (2,):
        return _wrong(path, f"has as edge_links {_named(links)}, not an integer array of shape (edges, 2)")
    if np.any((links < 0) | (links >= len(nodes))):
        return _outside(path, f"has an edge to a node that there is not, of {len(nodes)}")
    if space["edges"] is None or edges is None:
        return None if edges is None else _wrong(path, "has edges, and its space has none")
    if not _is_rows(edges) or len(edges) != len(links):
        return _wrong(path, f"has as edges {_named(edges)}, not one value for each of {len(links)} edge_links")
    return _parts([(str(n), space["edges"], edge) for n, edge in enumerate(edges)], f"{where}.edges", exact)


def _is_rows(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.ndim > 0


def _parts(parts: list[tuple[str, Space, Any]], path: str, exact: bool) -> Problem | None:
    for name, item, part in parts:
        if found := problem(item, part, f"{path or 'observation'}[{name}]", exact):
            return found
    return None


def _rows(value: Any) -> list[Any] | None:
    """Stacked values one by one: arrays by their first axis, dicts and tuples part by part."""
    if _is_rows(value):
        return list(value)
    if isinstance(value, dict):
        columns = [_rows(part) for part in value.values()]
        if any(column is None for column in columns):
            return None
        return [dict(zip(value, row, strict=True)) for row in zip(*columns, strict=False)]
    if isinstance(value, tuple):
        columns = [_rows(part) for part in value]
        return None if any(column is None for column in columns) else list(zip(*columns, strict=False))
    return None


def _first_outside(inside: Any, value: Any, space: Space, path: str) -> Problem | None:
    if np.all(inside):
        return None
    index = tuple(int(number) for number in np.argwhere(~np.asarray(inside))[0])
    where = f"{path or 'observation'}[{', '.join(map(str, index))}]" if index else path or "the observation"
    return "range", f"{where} is {value[index]}, outside {describe(space, index)}"


def _wrong(path: str, words: str) -> Problem:
    return "type", f"{path or 'the observation'} {words}"


def _outside(path: str, words: str) -> Problem:
    return "range", f"{path or 'the observation'} {words}"


def _named(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"a {value.dtype} array of shape {value.shape}"
    return "None" if value is None else f"a {type(value).__name__}"
