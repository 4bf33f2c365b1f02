"""Whether a value lies in a space, judged on the host from the space's description and the value's own bytes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from envcraft.spaces import spec
from envcraft.spaces.spec import Box, SpaceSpec
from envcraft.text import plural, with_article

#: Rounding by which a value may exceed a bound that an environment set itself, as a share of the bound.
_ROUNDING = 1e-5

#: ``("type" | "range", words)``.
Problem = tuple[str, str]
_Path = tuple[str, ...]
_Part = tuple[str, SpaceSpec, Any]
_OBSERVATION: _Path = ("the observation",)


def validate(space: SpaceSpec, value: Any, *, exact: bool = True) -> Problem | None:
    """Find the first problem of an observation.

    Args:
        space: a space that Gymnasium does not define accepts every value.
        value: as :class:`envcraft.spaces.codec.ValueCodec` decodes it.
        exact: judge by the letter, as a contract's space is. Otherwise judge as ``space.contains`` does: a dtype that
            casts safely, a list in place of a tuple, and a list or number in place of an array are accepted, and
            numbers may be off by rounding.

    Returns:
        A wrong type, shape or key as ``type``; a NaN or a number out of bounds as ``range``, with its index; or None.
    """
    return _validate(space, value, _OBSERVATION, exact)


def validate_range(space: Box, value: Any, *, exact: bool = True) -> Problem | None:
    """Find the first number of an array that is out of a Box's bounds. The dtype may differ from the Box's."""
    if not space.bounded or np.shape(value) != space.shape:
        return None
    return _in_bounds(space, np.asarray(value), _OBSERVATION, exact)


def validate_action(space: SpaceSpec, action: Any) -> str:
    """Return why an action is not in a space.

    Args:
        action: JSON, as :func:`envcraft.spaces.sampling.sample` draws it: lists stand for arrays and tuples.

    Returns:
        The reason, or an empty string for an action in the space.
    """
    try:
        problem = _action(space, action, ("the action",))
    except (ValueError, TypeError, OverflowError):
        return f"the action {str(action)[:80]} is not in {space}"
    if problem is None:
        return ""
    return problem[1] if problem[1].endswith(f"outside {space}") else f"{problem[1]}; the space is {space}"


def _action(space: SpaceSpec, action: Any, path: _Path) -> Problem | None:
    if isinstance(space, Box):
        with np.errstate(over="ignore"):
            return _validate(space, np.asarray(action, dtype=space.dtype), path, True)
    if isinstance(space, spec.MultiDiscrete | spec.MultiBinary):
        return _validate(space, np.asarray(action), path, True)
    parts = _action_parts(space, action)
    if parts is None:
        return _validate(space, action, path, True)
    problems = (_action(item, part, (*path, name)) for name, item, part in parts)
    return next(filter(None, problems), None)


def _action_parts(space: SpaceSpec, action: Any) -> list[_Part] | None:
    """The parts of a composite action, or None if it does not have the space's structure."""
    if isinstance(space, spec.Dict) and isinstance(action, dict) and set(action) == {name for name, _ in space.spaces}:
        return [(name, item, action[name]) for name, item in space.spaces]
    if isinstance(space, spec.Graph) and isinstance(action, dict) and set(action) == {"nodes", "edges", "links"}:
        return _graph_parts(space, **action)
    if not isinstance(action, list):
        return None
    if isinstance(space, spec.Tuple) and len(action) == len(space.spaces):
        return list(_numbered(zip(space.spaces, action, strict=True)))
    if isinstance(space, spec.Sequence):
        return list(_numbered((space.space, part) for part in action))
    if isinstance(space, spec.OneOf) and len(action) == 2 and _is_index(action[0], space.spaces):
        return [("1", space.spaces[action[0]], action[1])]
    return None


def _graph_parts(space: spec.Graph, nodes: Any, edges: Any, links: Any) -> list[_Part] | None:
    if not isinstance(nodes, list):
        return None
    parts = list(_numbered(((space.nodes, node) for node in nodes), "nodes, "))
    if edges is None and links is None:
        return parts
    if space.edges is None or not isinstance(edges, list) or not isinstance(links, list) or len(edges) != len(links):
        return None
    if not all(
        isinstance(ends, list) and len(ends) == 2 and all(_is_index(end, nodes) for end in ends) for ends in links
    ):
        return None
    return [*parts, *_numbered(((space.edges, edge) for edge in edges), "edges, ")]


def _is_index(number: Any, items: Any) -> bool:
    return isinstance(number, int) and not isinstance(number, bool) and 0 <= number < len(items)


def _numbered(pairs: Iterable[tuple[SpaceSpec, Any]], prefix: str = "") -> Iterable[_Part]:
    return ((f"{prefix}{index}", space, part) for index, (space, part) in enumerate(pairs))


def _validate(space: SpaceSpec, value: Any, path: _Path, exact: bool) -> Problem | None:
    match space:
        case Box():
            return _box(space, value, path, exact)
        case spec.Discrete():
            return _discrete(space, value, path, exact)
        case spec.MultiDiscrete() | spec.MultiBinary():
            return _integers(space, value, path, exact)
        case spec.Text():
            return _text(space, value, path)
        case spec.Dict():
            return _dict(space, value, path, exact)
        case spec.Tuple():
            return _tuple(space, value, path, exact)
        case spec.OneOf():
            return _one_of(space, value, path, exact)
        case spec.Sequence():
            return _sequence(space, value, path, exact)
        case spec.Graph():
            return _graph(space, value, path, exact)
    return None


def _box(space: Box, value: Any, path: _Path, exact: bool) -> Problem | None:
    dtype = np.dtype(space.dtype)
    if isinstance(value, np.generic) and space.shape == ():
        value = np.asarray(value)
    if not exact and isinstance(value, bool | int | float | list | tuple):
        value = _array(value, dtype)
    if not isinstance(value, np.ndarray):
        return _wrong(path, f"is {_named(value)}, not an array")
    if value.shape != space.shape:
        return _wrong(path, f"has shape {value.shape}, not {space.shape}")
    if value.dtype != dtype and (exact or not np.can_cast(value.dtype, dtype)):
        return _wrong(path, f"has dtype {value.dtype}, not {dtype}")
    if not space.bounded or space.spans_dtype:
        return None
    return _in_bounds(space, value, path, exact)


def _in_bounds(space: Box, value: Any, path: _Path, exact: bool) -> Problem | None:
    low, high = space.limits
    if not exact and np.dtype(space.dtype).kind == "f":
        low = low - _ROUNDING * np.maximum(1, np.abs(low))
        high = high + _ROUNDING * np.maximum(1, np.abs(high))
    return _first_outside((value >= low) & (value <= high), value, space, path)


def _array(value: Any, dtype: np.dtype[Any] | None = None) -> Any:
    """Numbers and lists as the array that ``contains`` makes of them; any other value unchanged."""
    try:
        with np.errstate(all="ignore"):
            made = np.asarray(value, dtype)
    except (ValueError, TypeError, OverflowError):
        return value
    return made if made.dtype.kind in "biuf" else value


def _discrete(space: spec.Discrete, value: Any, path: _Path, exact: bool) -> Problem | None:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if (exact and isinstance(value, bool)) or not isinstance(value, int | np.integer):
        return _wrong(path, f"is {_named(value)}, not an integer")
    if not space.start <= value < space.start + space.n:
        return _outside(path, f"is {value}, outside {space}")
    return None


def _integers(space: spec.MultiDiscrete | spec.MultiBinary, value: Any, path: _Path, exact: bool) -> Problem | None:
    nvec, start = space.limits if isinstance(space, spec.MultiDiscrete) else (np.full(space.shape, 2), 0)
    shape = nvec.shape
    if not exact and isinstance(value, list | tuple):
        value = _array(value)
    if (
        not isinstance(value, np.ndarray)
        or value.shape != shape
        or value.dtype.kind not in ("iub" if exact else "iubf")
    ):
        return _wrong(path, f"is {_named(value)}, not an integer array of shape {shape}")
    inside = (value >= start) & (value < start + nvec)
    if isinstance(space, spec.MultiBinary) and value.dtype.kind == "f":
        inside &= value == np.rint(value)
    return _first_outside(inside, value, space, path)


def _text(space: spec.Text, value: Any, path: _Path) -> Problem | None:
    if not isinstance(value, str):
        return _wrong(path, f"is {_named(value)}, not a str")
    if foreign := next((each for each in value if each not in space.charset), ""):
        return _outside(path, f"has the character {foreign!r}, which the charset of its space lacks")
    if not space.min_length <= len(value) <= space.max_length:
        length = f"{space.min_length} to {space.max_length}"
        return _outside(path, f"is a text of {plural(len(value), 'character')}, not of {length}")
    return None


def _dict(space: spec.Dict, value: Any, path: _Path, exact: bool) -> Problem | None:
    if not isinstance(value, dict):
        return _wrong(path, f"is {_named(value)}, not a dict")
    expected = {name for name, _ in space.spaces}
    if set(value) != expected:
        return _wrong(path, f"has the keys {sorted(value)}, not {sorted(expected)}")
    return _parts(((name, item, value[name]) for name, item in space.spaces), path, exact)


def _tuple(space: spec.Tuple, value: Any, path: _Path, exact: bool) -> Problem | None:
    parts = list(value) if isinstance(value, list | np.ndarray) and not exact else value
    if not isinstance(parts, tuple | list if not exact else tuple) or len(parts) != len(space.spaces):
        return _wrong(path, f"is {_named(value)}, not a tuple of {len(space.spaces)}")
    return _parts(_numbered(zip(space.spaces, parts, strict=True)), path, exact)


def _one_of(space: spec.OneOf, value: Any, path: _Path, exact: bool) -> Problem | None:
    if not isinstance(value, tuple) or len(value) != 2 or not isinstance(value[0], int | np.integer):
        return _wrong(path, f"is {_named(value)}, not a tuple of a number and a value")
    if not 0 <= value[0] < len(space.spaces):
        return _outside(path, f"chooses space {value[0]} of {len(space.spaces)}")
    return _validate(space.spaces[int(value[0])], value[1], (*path, "1"), exact)


def _sequence(space: spec.Sequence, value: Any, path: _Path, exact: bool) -> Problem | None:
    rows = _rows(value) if space.stack else value
    if not isinstance(rows, list if space.stack else tuple):
        what = "stacked values" if space.stack else "a tuple"
        return _wrong(path, f"is {_named(value)}, not {what}")
    return _parts(_numbered((space.space, row) for row in rows), path, exact)


def _graph(space: spec.Graph, value: Any, path: _Path, exact: bool) -> Problem | None:
    if not isinstance(value, tuple) or len(value) != 3 or not _is_rows(value[0]):
        return _wrong(path, f"is {_named(value)}, not a GraphInstance of nodes, edges and edge_links")
    nodes, edges, links = value
    if problem := _parts(_numbered(((space.nodes, node) for node in nodes), "nodes, "), path, exact):
        return problem
    if links is None:
        return None if edges is None else _wrong(path, "has edges and no edge_links")
    if not isinstance(links, np.ndarray) or links.dtype.kind not in "iu" or links.shape[1:] != (2,):
        return _wrong(path, f"has as edge_links {_named(links)}, not an integer array of shape (edges, 2)")
    if np.any((links < 0) | (links >= len(nodes))):
        return _outside(path, f"has an edge to a node that does not exist, of {len(nodes)}")
    if space.edges is None or edges is None:
        return None if edges is None else _wrong(path, "has edges, and its space has none")
    if not _is_rows(edges) or len(edges) != len(links):
        return _wrong(path, f"has as edges {_named(edges)}, not one value for each of {len(links)} edge_links")
    edge_space = space.edges
    return _parts(_numbered(((edge_space, edge) for edge in edges), "edges, "), path, exact)


def _is_rows(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.ndim > 0


def _parts(parts: Iterable[_Part], path: _Path, exact: bool) -> Problem | None:
    for name, item, part in parts:
        if problem := _validate(item, part, (*path, name), exact):
            return problem
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


def _first_outside(inside: Any, value: Any, space: SpaceSpec, path: _Path) -> Problem | None:
    if np.all(inside):
        return None
    index = tuple(int(number) for number in np.argwhere(~np.asarray(inside))[0])
    if index:
        path = (*path, ", ".join(map(str, index)))
    return "range", f"{_place(path)} is {value[index]}, outside {space.at(index) if isinstance(space, Box) else space}"


def _wrong(path: _Path, words: str) -> Problem:
    return "type", f"{_place(path)} {words}"


def _outside(path: _Path, words: str) -> Problem:
    return "range", f"{_place(path)} {words}"


def _place(path: _Path) -> str:
    root, *parts = path
    return root.removeprefix("the ") + "".join(f"[{part}]" for part in parts) if parts else root


def _named(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{with_article(value.dtype)} array of shape {value.shape}"
    return "None" if value is None else with_article(type(value).__name__)
