"""All that an environment holds, as plain values: what tells its states apart."""

from __future__ import annotations

import enum
import hashlib
import random
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import gymnasium
import numpy as np
from envcraft_runtime.classes import type_name

#: Values and levels that are looked into.
_MOST, _DEEPEST = 20_000, 24
_GENERATORS = (np.random.Generator, np.random.RandomState, random.Random)
#: They are part of the program, and no state.
_CODE = (type, ModuleType, FunctionType, BuiltinFunctionType)


class State:
    """The attributes of `env` and whatever they refer to, each object looked into once.

    Attributes:
        values: an image of each attribute, as JSON, random generators left out.
        generators: the states of all random generators.
        opaque: whether something could not be looked into, so that two states may differ with equal images.
    """

    def __init__(self, env: Any) -> None:
        self.generators: list[str] = []
        self.opaque = False
        self._numbers: dict[int, int] = {}
        # An object that has gone may leave its id to another one.
        self._kept: list[Any] = []
        try:
            self.values = {name: self._image(value, 0) for name, value in vars(env.unwrapped).items()}
        except Exception:
            # Its own methods are asked on the way.
            self.values, self.opaque = {}, True

    def _image(self, value: Any, depth: int) -> Any:
        if value is None or isinstance(value, bool | str):
            return value
        if isinstance(value, int | float | complex | bytes) and not isinstance(value, enum.Enum):
            return repr(value)
        if isinstance(value, gymnasium.Space):
            return self._image(value._np_random, depth)
        if isinstance(value, _CODE):
            # What a function has closed over may change.
            self.opaque |= bool(getattr(value, "__closure__", None))
            return None
        if isinstance(value, _GENERATORS):
            self.generators.append(_generator(value))
            return None
        if id(value) in self._numbers:
            return {"again": self._numbers[id(value)]}
        if depth > _DEEPEST or len(self._numbers) > _MOST:
            self.opaque = True
            return None
        self._numbers[id(value)] = len(self._numbers)
        self._kept.append(value)
        return self._inside(value, depth + 1)

    def _inside(self, value: Any, depth: int) -> Any:
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            return [str(value.dtype), list(value.shape), hashlib.blake2b(value.tobytes(), digest_size=16).hexdigest()]
        if isinstance(value, dict):
            inside = [[self._image(key, depth), self._image(item, depth)] for key, item in value.items()]
            return {type_name(value): inside, "more": self._attributes(value, depth)}
        if isinstance(value, list | tuple):
            return [type_name(value), [self._image(item, depth) for item in value], self._attributes(value, depth)]
        if isinstance(value, set | frozenset):
            return [type_name(value), sorted(repr(self._image(item, depth)) for item in value)]
        if isinstance(value, MethodType):
            return [value.__name__, self._image(value.__self__, depth)]
        if isinstance(value, np.ndarray):
            return [list(value.shape), [self._image(item, depth) for item in value.ravel().tolist()]]
        return [type_name(value), self._attributes(value, depth), self._reduced(value, depth)]

    def _attributes(self, value: Any, depth: int) -> dict[str, Any]:
        """Those in ``__dict__`` and ``__slots__``."""
        names = [name for kind in type(value).__mro__ for name in _slots(kind)]
        found = {name: self._image(getattr(value, name), depth) for name in names if hasattr(value, name)}
        return found | {name: self._image(item, depth) for name, item in getattr(value, "__dict__", {}).items()}

    def _reduced(self, value: Any, depth: int) -> Any:
        """What the object itself would be copied by."""
        buffer = getattr(value, "get_buffer", None)
        try:
            if buffer is not None:
                return hashlib.blake2b(buffer().raw, digest_size=16).hexdigest()
            reduced = value.__reduce_ex__(2)
        except Exception:
            self.opaque = True
            return None
        parts = reduced[1:] if isinstance(reduced, tuple) else ()
        # After arguments and state come iterators, over items of a list and of a dict.
        listed = [*parts[:2], *(list(part) for part in parts[2:4] if part is not None)]
        return [self._image(part, depth) for part in listed]


def _slots(kind: type) -> list[str]:
    told = vars(kind).get("__slots__", ())
    names = [told] if isinstance(told, str) else list(told)
    private = "_" + kind.__name__.lstrip("_")
    return [private + name if name.startswith("__") and not name.endswith("__") else name for name in names]


def _generator(value: Any) -> str:
    if isinstance(value, np.random.Generator):
        return repr(value.bit_generator.state)
    return repr(value.get_state() if isinstance(value, np.random.RandomState) else value.getstate())
