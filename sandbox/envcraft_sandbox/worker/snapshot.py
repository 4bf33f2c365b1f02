"""A state of an environment that can be returned to: taken once, restored as often as wanted.

What is restored is what ``copy.deepcopy`` of the environment would have given, several times sooner: it is pickled with
all that it holds, in memory that never leaves this process, and what pickle is slow with or cannot take is set aside as
a *part*: arrays, random generators and pictures, each copied on its way in and on its way out, and what copies share
anyway (functions, classes, modules, numbers of NumPy, spaces that nothing was drawn from). Where an environment says
itself how it is to be copied, or cannot be pickled, ``copy.deepcopy`` it is.
"""

from __future__ import annotations

import copy
import enum
import io
import pickle
import sys
import weakref
from collections.abc import Callable, Hashable
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

_CODE = (type, FunctionType, ModuleType, CodeType, property)
_SHARED = (*_CODE, weakref.ref, enum.Enum, np.number, np.bool_)
_SPACES = (spaces.Box, spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete, spaces.Text)


class Snapshot:
    """The state that `env` is in now.

    Raises whatever the environment's own methods raise while it is copied, and ``TypeError`` where it cannot be.

    Attributes:
        key: equal only for equal states, though not for all of them: some are pickled in several ways; None where
            nothing is known.
    """

    def __init__(self, env: Any) -> None:
        self._parts: list[_Part] = []
        self._whole: Any = None
        stream = io.BytesIO()
        try:
            _Taking(stream, self._parts).dump(env)
        except Exception:
            self._whole = copy.deepcopy(env)
        self._bytes = stream.getvalue()

    def restore(self) -> Any:
        """An environment in that state, which shares nothing that changes with any other."""
        if self._whole is not None:
            return copy.deepcopy(self._whole)
        return _Restoring(self._bytes, self._parts).load()

    @property
    def key(self) -> Hashable:
        if self._whole is not None:
            return None
        return self._bytes, *(part.content() for part in self._parts)


class _Part(NamedTuple):
    """Something that is set aside: what gives a new one at each call, and what tells it from others."""

    restore: Callable[[], Any]
    content: Callable[[], Hashable]


class _Taking(pickle.Pickler):
    def __init__(self, stream: io.BytesIO, parts: list[_Part]) -> None:
        super().__init__(stream, 5)
        self._parts = parts

    def reducer_override(self, held: Any) -> Any:
        if held is _part:
            return NotImplemented
        part = _set_aside(held)
        if part is None:
            return NotImplemented
        self._parts.append(part)
        return _part, (len(self._parts) - 1,)


class _Restoring(pickle.Unpickler):
    def __init__(self, data: bytes, parts: list[_Part]) -> None:
        super().__init__(io.BytesIO(data))
        self._parts = parts

    def find_class(self, module: str, name: str) -> Any:
        return self._part if (module, name) == (__name__, _part.__name__) else super().find_class(module, name)

    def _part(self, number: int) -> Any:
        return self._parts[number].restore()


def _part(number: int) -> Any:
    """Stands in the pickle for a part; whoever restores it knows the parts."""
    raise LookupError(number)


def _set_aside(held: Any) -> _Part | None:
    """The part that `held` becomes; None where it is pickled as it is."""
    kind = type(held)
    of_nothing = kind is BuiltinFunctionType and isinstance(held.__self__, ModuleType | type(None))
    if of_nothing or isinstance(held, _SHARED) or (kind in _SPACES and held._np_random is None):
        return _Part(lambda: held, lambda: id(held))
    if isinstance(held, np.ndarray):
        if kind is not np.ndarray or held.dtype.hasobject:
            return None
        kept = held.copy("K")
        return _Part(lambda: kept.copy("K"), lambda: (kept.dtype.str, kept.shape, kept.tobytes()))
    if kind is np.random.Generator and type(held.bit_generator.seed_seq) is np.random.SeedSequence:
        return _generator(held.bit_generator)
    if kind is getattr(sys.modules.get("pygame"), "Surface", None):
        picture = held.copy()
        return _Part(picture.copy, lambda: (picture.get_size(), picture.get_buffer().raw))
    if hasattr(kind, "__deepcopy__"):
        raise TypeError(f"{kind.__name__} says itself how it is copied")
    return None


def _generator(source: Any) -> _Part:
    kind, seeds, state = type(source), copy.copy(source.seed_seq), source.state

    def restored() -> np.random.Generator:
        # It counts the generators that were spawned from it.
        bits = kind(copy.copy(seeds))
        bits.state = state
        return np.random.Generator(bits)

    return _Part(restored, lambda: (repr(state), seeds.n_children_spawned))
