"""The one model of a space: read from JSON with bounds, compare and print.

A space comes to the host as JSON, from a contract or from the worker, which is not trusted. :func:`read_space` makes a
:class:`SpaceSpec` of it; the other modules of this package sample, validate and convert what it reads.
"""

from __future__ import annotations

import math
import re
import string
from functools import cached_property
from typing import Annotated, Any, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.errors import MalformedValue

_MAX_ELEMENTS = 8 * 1024 * 1024
#: Levels of objects and lists.
_MAX_DEPTH = 27
#: The name of a type. NumPy parses other strings as Python, and raises errors of many kinds.
_DTYPE = re.compile(r"[a-z]+[0-9]*")
#: The characters of Gymnasium's Text spaces that name none.
_ALPHANUMERIC = frozenset(string.ascii_letters + string.digits)
#: The characters of a charset in a text.
_SHOWN = 20
_CHILDREN = ("space", "spaces", "nodes", "edges")

Shape = Annotated[tuple[Annotated[int, msgspec.Meta(ge=0, le=_MAX_ELEMENTS)], ...], msgspec.Meta(max_length=32)]
Number = int | float | str
Bound = Number | tuple[Number, ...] | None


class SpaceSpec(msgspec.Struct, frozen=True, tag_field="type", forbid_unknown_fields=True):
    """A Gymnasium space as immutable data. Two are equal if they describe the same space, bounds included."""

    def __str__(self) -> str:
        return type(self).__name__

    @property
    def known(self) -> bool:
        """Whether Gymnasium defines this space and all spaces in it; packages define kinds of their own."""
        return all(_all_known(value) for value in msgspec.structs.astuple(self))


class Box(SpaceSpec, frozen=True, tag="Box", dict=True):
    """Arrays of `shape` and `dtype`.

    Attributes:
        low: one number, a flat tuple of one number for each element, or None if the worker sent no bounds.
        high: likewise.
    """

    low: Bound
    high: Bound
    shape: Shape
    dtype: str

    def __post_init__(self) -> None:
        size, dtype = _size(self.shape), _dtype(self.dtype)
        for side in ("low", "high"):
            bound = getattr(self, side)
            if isinstance(bound, tuple):
                if len(bound) != size:
                    raise ValueError(f"{len(bound)} bounds for {size} elements")
                numbers = tuple(_number(item, dtype) for item in bound)
                bound = numbers[0] if len(set(numbers)) == 1 else numbers
            elif bound is not None:
                bound = _number(bound, dtype)
            msgspec.structs.force_setattr(self, side, bound)
        if self.bounded and not np.all(np.asarray(self.low) <= np.asarray(self.high)):
            raise ValueError("low is above high")

    def __str__(self) -> str:
        return self.at(())

    def at(self, index: tuple[int, ...]) -> str:
        """Print the space as Gymnasium does, with the bounds of the element at `index`."""
        low, high = (self._bound_at(bound, index) for bound in (self.low, self.high))
        return f"Box({low}, {high}, {self.shape}, {self.dtype})"

    def _bound_at(self, bound: Bound, index: tuple[int, ...]) -> str:
        if not isinstance(bound, tuple):
            return str(bound)
        if not bound:
            return "[]"
        return str(bound[int(np.ravel_multi_index(index, self.shape))]) if index else f"{bound[0]}…"

    @property
    def bounded(self) -> bool:
        """Whether the bounds are known."""
        return self.low is not None and self.high is not None

    @property
    def spans_dtype(self) -> bool:
        """Whether every value of the dtype is in bounds, as in a frame of uint8 from 0 to 255."""
        return _dtype(self.dtype).kind != "f" and (self.low, self.high) == _limits(_dtype(self.dtype))

    @cached_property
    def limits(self) -> tuple[Any, Any]:
        """Lowest and highest values to compare with: one number, or an array of `shape`."""
        return self._limit(self.low), self._limit(self.high)

    def _limit(self, bound: Bound) -> Any:
        # A NumPy scalar, as a Python float would be rounded to the dtype of the array that it is compared with.
        return np.reshape(bound, self.shape) if isinstance(bound, tuple) else np.asarray(bound)[()]

    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest values as float64 arrays of `shape`."""
        low, high = (np.broadcast_to(np.asarray(limit, np.float64), self.shape) for limit in self.limits)
        return low, high


class Discrete(SpaceSpec, frozen=True, tag="Discrete"):
    """The `n` integers from `start` on."""

    n: Annotated[int, msgspec.Meta(ge=1, lt=2**62)]
    start: Annotated[int, msgspec.Meta(gt=-(2**62), lt=2**62)] = 0

    def __str__(self) -> str:
        return f"Discrete({self.n})" if not self.start else f"Discrete({self.n}, start={self.start})"


class MultiDiscrete(SpaceSpec, frozen=True, tag="MultiDiscrete", dict=True):
    """Integer arrays: the element at an index is one of `nvec` integers from `start` on. Both are nested tuples."""

    nvec: int | tuple[Any, ...]
    start: int | tuple[Any, ...] | None = None
    dtype: str = "int64"

    def __post_init__(self) -> None:
        _dtype(self.dtype)
        nvec = np.asarray(self.nvec, np.int64)
        start = np.zeros_like(nvec) if self.start is None else np.asarray(self.start, np.int64)
        if nvec.size > _MAX_ELEMENTS or np.any(nvec < 1) or start.shape != nvec.shape:
            raise ValueError("no values, or starts of another shape")
        msgspec.structs.force_setattr(self, "nvec", _nested(nvec.tolist()))
        msgspec.structs.force_setattr(self, "start", _nested(start.tolist()))

    def __str__(self) -> str:
        nvec, start = self.limits
        parts = [str(nvec.tolist())]
        parts += [f"start={start.tolist()}"] if start.any() else []
        parts += [f"dtype={self.dtype}"] if self.dtype != "int64" else []
        return f"MultiDiscrete({', '.join(parts)})"

    @cached_property
    def limits(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """`nvec` and `start` as arrays."""
        return np.asarray(self.nvec, np.int64), np.asarray(self.start, np.int64)


class MultiBinary(SpaceSpec, frozen=True, tag="MultiBinary"):
    """Arrays of zeros and ones."""

    shape: Shape

    def __post_init__(self) -> None:
        _size(self.shape)

    def __str__(self) -> str:
        return f"MultiBinary({self.shape[0] if len(self.shape) == 1 else self.shape})"


class Text(SpaceSpec, frozen=True, tag="Text"):
    """Strings of `charset`."""

    min_length: Annotated[int, msgspec.Meta(ge=0)]
    max_length: Annotated[int, msgspec.Meta(le=_MAX_ELEMENTS)]
    charset: Annotated[str, msgspec.Meta(min_length=1)]

    def __post_init__(self) -> None:
        if self.min_length > self.max_length:
            raise ValueError("min_length is above max_length")

    def __str__(self) -> str:
        shown = self.charset[:_SHOWN] + "…" * (len(self.charset) > _SHOWN)
        charset = "" if {*self.charset} == _ALPHANUMERIC else f", charset={shown!r}"
        return f"Text({self.min_length}, {self.max_length}{charset})"


class Dict(SpaceSpec, frozen=True, tag="Dict"):
    """Dicts with a value for each name in `spaces`, which holds pairs of name and space."""

    spaces: tuple[tuple[str, Spec], ...]

    def __str__(self) -> str:
        return "Dict(" + ", ".join(f"{name}: {space}" for name, space in self.spaces) + ")"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Dict) and dict(self.spaces) == dict(other.spaces)

    def __hash__(self) -> int:
        return hash(frozenset(self.spaces))


class Tuple(SpaceSpec, frozen=True, tag="Tuple"):
    """Tuples with a value for each space."""

    spaces: tuple[Spec, ...]

    def __str__(self) -> str:
        return f"Tuple({', '.join(map(str, self.spaces))})"


class OneOf(SpaceSpec, frozen=True, tag="OneOf"):
    """Pairs of the index of a space and a value in that space."""

    spaces: Annotated[tuple[Spec, ...], msgspec.Meta(min_length=1)]

    def __str__(self) -> str:
        return f"OneOf({', '.join(map(str, self.spaces))})"


class Sequence(SpaceSpec, frozen=True, tag="Sequence"):
    """Tuples of any number of values in `space`; with `stack` batched as arrays."""

    space: Spec
    stack: bool

    def __str__(self) -> str:
        return f"Sequence({self.space}, stack={self.stack})"


class Graph(SpaceSpec, frozen=True, tag="Graph"):
    """``GraphInstance`` tuples: an array of nodes, and of edges unless `edges` is None."""

    nodes: Spec
    edges: Spec | None

    def __str__(self) -> str:
        return f"Graph({self.nodes}, {self.edges})"


class Unknown(SpaceSpec, frozen=True, tag="Unknown"):
    """A type that is not defined by Gymnasium. `custom` if it subclasses ``gymnasium.Space``."""

    name: str
    custom: bool = False

    def __str__(self) -> str:
        return self.name

    @property
    def known(self) -> bool:
        return False


Spec = Box | Discrete | MultiDiscrete | MultiBinary | Text | Dict | Tuple | OneOf | Sequence | Graph | Unknown

#: The spaces that Gymnasium defines, by name.
KINDS: dict[str, type[SpaceSpec]] = {kind.__name__: kind for kind in get_args(Spec) if kind is not Unknown}


def read_space(value: Any) -> SpaceSpec:
    """Read the JSON description of a space.

    Args:
        value: what :func:`envcraft_protocol.spaces.describe` writes. A ``type`` that Gymnasium does not define gives
            :class:`Unknown`.

    Raises:
        MalformedValue: the description has another form, contradicts itself or is too large.
    """
    try:
        space: SpaceSpec = msgspec.convert(_mark_unknown(value, 0), Spec)
    except (msgspec.ValidationError, OverflowError) as error:
        raise MalformedValue(f"a space that cannot be read: {str(error)[:200]}") from None
    return space


def difference(one: SpaceSpec, two: SpaceSpec) -> tuple[str, str, str]:
    """Print two spaces that are not equal, as far as they differ.

    Returns:
        The place of the first difference, such as ``[arm][2]``, and both spaces there.
    """
    children = _children(one), _children(two)
    if type(one) is type(two) and [name for name, _ in children[0]] == [name for name, _ in children[1]]:
        for (name, first), (_, second) in zip(*children, strict=True):
            if first != second:
                place, *inner = difference(first, second)
                return f"[{name}]{place}", inner[0], inner[1]
    texts = str(one), str(two)
    if isinstance(one, Box) and isinstance(two, Box) and one.bounded and two.bounded:
        bounds = one.low, one.high, two.low, two.high
        if (one.shape, one.dtype) == (two.shape, two.dtype) and any(isinstance(bound, tuple) for bound in bounds):
            apart = [np.broadcast_to(a != b, one.shape) for a, b in zip(one.limits, two.limits, strict=True)]
            index = tuple(np.argwhere(np.logical_or(*apart))[0].tolist())
            return f"[{', '.join(map(str, index))}]", one.at(index), two.at(index)
    if texts[0] == texts[1] and isinstance(one, Text) and isinstance(two, Text):
        letter = min({*one.charset} ^ {*two.charset})
        has = ["with" if letter in space.charset else "without" for space in (one, two)]
        return "", f"{texts[0]} {has[0]} {letter!r}", f"{texts[1]} {has[1]} {letter!r}"
    return "", *texts


def _children(space: SpaceSpec) -> list[tuple[Any, SpaceSpec]]:
    """The spaces inside a space, each with its name."""
    match space:
        case Dict(spaces=pairs):
            return list(pairs)
        case Tuple(spaces=items) | OneOf(spaces=items):
            return list(enumerate(items))
        case Sequence(space=item):
            return [("space", item)]
        case Graph(nodes=nodes, edges=edges):
            return [("nodes", nodes), *([("edges", edges)] if edges is not None else [])]
    return []


def _mark_unknown(value: Any, depth: int) -> Any:
    """Copy a description with each unknown type replaced by the fields of :class:`Unknown`."""
    if depth > _MAX_DEPTH:
        raise MalformedValue("a space that is nested too deeply")
    if isinstance(value, list | tuple):
        return [_mark_unknown(item, depth + 1) for item in value]
    if not isinstance(value, dict) or not isinstance(value.get("type"), str):
        return value
    if value["type"] not in KINDS:
        return {"type": "Unknown", "name": value["type"], "custom": bool(value.get("custom"))}
    return {name: _mark_unknown(item, depth + 1) if name in _CHILDREN else item for name, item in value.items()}


def _all_known(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_all_known, value))
    return value.known if isinstance(value, SpaceSpec) else True


def _size(shape: tuple[int, ...]) -> int:
    size = math.prod(shape)
    if size > _MAX_ELEMENTS:
        raise ValueError(f"{size} elements")
    return size


def _dtype(name: str) -> np.dtype[Any]:
    try:
        dtype = np.dtype(name) if _DTYPE.fullmatch(name) else None
    except TypeError:
        dtype = None
    if dtype is None or dtype.kind not in "biuf":
        raise ValueError(f"dtype {name[:40]!r} is not a type of numbers, such as uint8 or float32")
    return dtype


def _limits(dtype: np.dtype[Any]) -> tuple[int, int]:
    return (0, 1) if dtype.kind == "b" else (int(np.iinfo(dtype).min), int(np.iinfo(dtype).max))


def _number(value: Number, dtype: np.dtype[Any]) -> int | float:
    """A bound as a number of the dtype's kind; infinities of an integer dtype are its limits."""
    number = float(value)
    if dtype.kind == "f":
        return number
    low, high = _limits(dtype)
    if number <= low or number >= high:
        return low if number <= low else high
    return int(value) if number.is_integer() else number


def _nested(value: Any) -> Any:
    return tuple(map(_nested, value)) if isinstance(value, list) else value
