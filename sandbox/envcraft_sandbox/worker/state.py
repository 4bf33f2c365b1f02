"""The contents of an environment as plain values, which distinguish its states."""

from __future__ import annotations

import enum
import functools
import random
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import gymnasium
import numpy as np
from envcraft_protocol.classes import type_name

#: Maximum number of values and of levels to examine.
_MOST, _DEEPEST = 20_000, 24
_GENERATORS = (np.random.Generator, np.random.RandomState, random.Random)
_CODE = (type, ModuleType, FunctionType, BuiltinFunctionType)
#: Types that their text represents completely, and types that have only their items.
_PLAIN = {type(None), bool, int, float, complex, str, bytes}
_JSON = {type(None), bool, str}
_PLAIN_LISTS = (list, tuple)
#: The attributes of a space besides numbers.
_OF_SPACES = {"_np_random", "spaces"}


class State:
    """The attributes of `env`, of its wrappers, and of what they refer to. Each object is examined once.

    Attributes:
        values: a JSON image of each attribute, without random generators.
        generators: the states of all random generators.
        opaque: some value could not be examined, so two different states may have equal images.
    """

    def __init__(self, env: Any) -> None:
        self.generators: list[str] = []
        self.opaque = False
        self._left = _MOST
        self._numbers: dict[int, int] = {}
        # A freed object may leave its id to another one.
        self._kept: list[Any] = []
        chain = [env]
        while chain[-1] is not env.unwrapped and len(chain) < _DEEPEST:
            chain.append(getattr(chain[-1], "env", env.unwrapped))
        for own in chain:
            # References back to the environment add nothing.
            self._number(own)
        self.values = self._attributes(env.unwrapped, 0)
        for place, wrapper in enumerate(chain[:-1]):
            held = {name: value for name, value in vars(wrapper).items() if name != "env"}
            self.values |= {f"{place} {name}": self._image(value, 0) for name, value in held.items()}

    def _number(self, value: Any) -> None:
        self._numbers[id(value)] = len(self._numbers)
        self._kept.append(value)

    def _image(self, value: Any, depth: int) -> Any:
        self._left -= 1
        if self._left < 0 or depth > _DEEPEST:
            self.opaque = True
            return None
        if type(value) in _PLAIN:
            return value if type(value) in _JSON else ["", repr(value)]
        if isinstance(value, _GENERATORS):
            self.generators.append(_generator(value))
            # A subclass may have more state than its numbers.
            self.opaque |= type(value) not in _GENERATORS
            return None
        if isinstance(value, _CODE):
            return self._code(value, depth)
        if id(value) in self._numbers:
            return {"again": self._numbers[id(value)]}
        if not isinstance(value, tuple | frozenset | np.generic):
            # Equal immutable objects need not be distinguished.
            self._number(value)
        try:
            return self._inside(value, depth + 1)
        except Exception:
            # The object's own methods run here.
            self.opaque = True
            return None

    def _code(self, value: Any, depth: int) -> Any:
        """The identity of a function, class or module, which copies of a state share."""
        bound = getattr(value, "__self__", None)
        if isinstance(value, BuiltinFunctionType) and not isinstance(bound, ModuleType | type(None)):
            return [value.__name__, self._image(bound, depth)]
        # The closure and the attributes of a function may change.
        self.opaque |= bool(getattr(value, "__closure__", None))
        self.opaque |= isinstance(value, FunctionType) and bool(vars(value))
        return ["code", id(value)]

    def _inside(self, value: Any, depth: int) -> Any:
        if type(value) in _PLAIN_LISTS and _PLAIN.issuperset(map(type, value)):
            self._left -= len(value)
            self.opaque |= self._left < 0
            return [type_name(value), repr(value)]
        if isinstance(value, gymnasium.Space):
            # The bounds of pictures are long, and no game changes them.
            parts = {name: part for name, part in vars(value).items() if name in _OF_SPACES or _is_short(part)}
            return [[name, self._image(part, depth)] for name, part in parts.items()]
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            self.opaque |= isinstance(value, np.ndarray) and type(value) is not np.ndarray
            return [value.dtype.str, list(value.shape), hash(value.tobytes())]
        if isinstance(value, dict):
            inside = [[self._image(key, depth), self._image(item, depth)] for key, item in value.items()]
            return [type_name(value), inside, self._attributes(value, depth)]
        if isinstance(value, list | tuple):
            return [type_name(value), [self._image(item, depth) for item in value], self._attributes(value, depth)]
        if isinstance(value, set | frozenset):
            # Other items have no order that would distinguish them.
            self.opaque |= not all(_plain(item) for item in value)
            return [type_name(value), sorted(repr(self._image(item, depth)) for item in value)]
        if isinstance(value, MethodType):
            return [value.__name__, self._image(value.__self__, depth)]
        if isinstance(value, np.ndarray):
            return [list(value.shape), [self._image(item, depth) for item in value.ravel().tolist()]]
        return [type_name(value), self._attributes(value, depth), self._reduced(value, depth)]

    def _attributes(self, value: Any, depth: int) -> dict[str, Any]:
        """The attributes in ``__dict__`` and ``__slots__``."""
        kind: type = type(value)
        names = _slots(kind)
        found = {name: self._image(getattr(value, name), depth) for name in names if hasattr(value, name)}
        return found | {name: self._image(item, depth) for name, item in getattr(value, "__dict__", {}).items()}

    def _reduced(self, value: Any, depth: int) -> Any:
        """The values that the object itself would be copied by, or the bytes of a picture."""
        if type_name(value).startswith("pygame.") and hasattr(value, "get_buffer"):
            shown: list[Any] = []
            if hasattr(value, "get_clip"):
                shown = [value.get_alpha(), value.get_colorkey(), tuple(value.get_clip())]
            return [hash(value.get_buffer().raw), repr(shown)]
        reduced = value.__reduce_ex__(2)
        parts = reduced[1:] if isinstance(reduced, tuple) else ()
        # Arguments and state come first, then iterators over the items of a list and of a dict.
        listed = [*parts[:2], *(list(part) for part in parts[2:4] if part is not None)]
        return [self._image(part, depth) for part in listed]


def _is_short(value: Any) -> bool:
    return type(value) in _PLAIN or isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.size < 64)


def _plain(value: Any) -> bool:
    if isinstance(value, tuple | frozenset):
        return all(map(_plain, value))
    return value is None or isinstance(value, bool | int | float | str | bytes | np.generic | enum.Enum)


@functools.cache
def _slots(kind: type) -> list[str]:
    """The attributes that a class and its bases keep outside ``__dict__``."""
    names: list[str] = []
    for part in kind.__mro__:
        slots = vars(part).get("__slots__", ())
        private = "_" + part.__name__.lstrip("_")
        for name in [slots] if isinstance(slots, str) else slots:
            names.append(private + name if name.startswith("__") and not name.endswith("__") else name)
    return names


def _generator(value: Any) -> str:
    if isinstance(value, np.random.Generator):
        return repr(value.bit_generator.state)
    return repr(value.get_state() if isinstance(value, np.random.RandomState) else value.getstate())
