"""All that an environment holds, as plain values: what tells its states apart."""

from __future__ import annotations

import enum
import functools
import random
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import gymnasium
import numpy as np
from envcraft_runtime.classes import type_name

#: Values and levels that are looked into.
_MOST, _DEEPEST = 20_000, 24
_GENERATORS = (np.random.Generator, np.random.RandomState, random.Random)
_CODE = (type, ModuleType, FunctionType, BuiltinFunctionType)
#: What its text tells whole, and what holds nothing beside its items.
_PLAIN = {type(None), bool, int, float, complex, str, bytes}
_JSON = {type(None), bool, str}
_PLAIN_LISTS = (list, tuple)
#: What a space holds besides numbers, and the spaces in it.
_OF_SPACES = {"_np_random", "spaces"}


class State:
    """The attributes of `env`, of its wrappers, and whatever they refer to; each object is looked into once.

    Attributes:
        values: an image of each attribute, as JSON, random generators left out.
        generators: the states of all random generators.
        opaque: whether something could not be looked into, so that two states may differ with equal images.
    """

    def __init__(self, env: Any) -> None:
        self.generators: list[str] = []
        self.opaque = False
        self._left = _MOST
        self._numbers: dict[int, int] = {}
        # An object that has gone may leave its id to another one.
        self._kept: list[Any] = []
        chain = [env]
        while chain[-1] is not env.unwrapped and len(chain) < _DEEPEST:
            chain.append(getattr(chain[-1], "env", env.unwrapped))
        for own in chain:
            # What refers back to the environment adds nothing to it.
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
            # One of a class of its own may hold more than its numbers.
            self.opaque |= type(value) not in _GENERATORS
            return None
        if isinstance(value, _CODE):
            return self._code(value, depth)
        if id(value) in self._numbers:
            return {"again": self._numbers[id(value)]}
        if not isinstance(value, tuple | frozenset | np.generic):
            # Of what cannot be changed, which of two equal ones it is makes no difference.
            self._number(value)
        try:
            return self._inside(value, depth + 1)
        except Exception:
            # Its own methods are asked on the way.
            self.opaque = True
            return None

    def _code(self, value: Any, depth: int) -> Any:
        """Which function, class or module it is; copies of a state share them."""
        bound = getattr(value, "__self__", None)
        if isinstance(value, BuiltinFunctionType) and not isinstance(bound, ModuleType | type(None)):
            return [value.__name__, self._image(bound, depth)]
        # What a function has closed over may change, and so may its attributes.
        self.opaque |= bool(getattr(value, "__closure__", None))
        self.opaque |= isinstance(value, FunctionType) and bool(vars(value))
        return ["code", id(value)]

    def _inside(self, value: Any, depth: int) -> Any:
        if type(value) in _PLAIN_LISTS and _PLAIN.issuperset(map(type, value)):
            self._left -= len(value)
            self.opaque |= self._left < 0
            return [type_name(value), repr(value)]
        if isinstance(value, gymnasium.Space):
            # Not the bounds of pictures, which are long, and which no game changes.
            told = {name: part for name, part in vars(value).items() if name in _OF_SPACES or _is_short(part)}
            return [[name, self._image(part, depth)] for name, part in told.items()]
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            self.opaque |= isinstance(value, np.ndarray) and type(value) is not np.ndarray
            return [value.dtype.str, list(value.shape), hash(value.tobytes())]
        if isinstance(value, dict):
            inside = [[self._image(key, depth), self._image(item, depth)] for key, item in value.items()]
            return [type_name(value), inside, self._attributes(value, depth)]
        if isinstance(value, list | tuple):
            return [type_name(value), [self._image(item, depth) for item in value], self._attributes(value, depth)]
        if isinstance(value, set | frozenset):
            # Others have no order of their own, by which they could be told apart.
            self.opaque |= not all(_plain(item) for item in value)
            return [type_name(value), sorted(repr(self._image(item, depth)) for item in value)]
        if isinstance(value, MethodType):
            return [value.__name__, self._image(value.__self__, depth)]
        if isinstance(value, np.ndarray):
            return [list(value.shape), [self._image(item, depth) for item in value.ravel().tolist()]]
        return [type_name(value), self._attributes(value, depth), self._reduced(value, depth)]

    def _attributes(self, value: Any, depth: int) -> dict[str, Any]:
        """Those in ``__dict__`` and ``__slots__``."""
        kind: type = type(value)
        names = _slots(kind)
        found = {name: self._image(getattr(value, name), depth) for name in names if hasattr(value, name)}
        return found | {name: self._image(item, depth) for name, item in getattr(value, "__dict__", {}).items()}

    def _reduced(self, value: Any, depth: int) -> Any:
        """What the object itself would be copied by, or a picture's bytes."""
        if type_name(value).startswith("pygame.") and hasattr(value, "get_buffer"):
            shown: list[Any] = []
            if hasattr(value, "get_clip"):
                shown = [value.get_alpha(), value.get_colorkey(), tuple(value.get_clip())]
            return [hash(value.get_buffer().raw), repr(shown)]
        reduced = value.__reduce_ex__(2)
        parts = reduced[1:] if isinstance(reduced, tuple) else ()
        # After arguments and state come iterators, over items of a list and of a dict.
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
    """The attributes that a class and those it is made of keep outside ``__dict__``."""
    names: list[str] = []
    for part in kind.__mro__:
        told = vars(part).get("__slots__", ())
        private = "_" + part.__name__.lstrip("_")
        for name in [told] if isinstance(told, str) else told:
            names.append(private + name if name.startswith("__") and not name.endswith("__") else name)
    return names


def _generator(value: Any) -> str:
    if isinstance(value, np.random.Generator):
        return repr(value.bit_generator.state)
    return repr(value.get_state() if isinstance(value, np.random.RandomState) else value.getstate())
