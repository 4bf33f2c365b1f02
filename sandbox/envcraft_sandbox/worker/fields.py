"""What an environment and its module hold, field by field, so that the host can say where two runs first differ.

A field is a path, such as ``self.ball.x``, with a digest and a short text. No method of the subject is called: only
plain values, NumPy arrays, random generators, containers, and the attributes of objects of the subject's own classes
are read, the latter past ``__getattribute__`` and properties. Anything else has no field.
"""

from __future__ import annotations

import _random
import collections
import enum
import itertools
import json
import os
import random
import sys
from collections.abc import Callable, Iterable, Iterator
from types import FunctionType, GetSetDescriptorType, MemberDescriptorType, ModuleType, SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import xxhash
from envcraft_protocol.wire import MAX_FIELD_LINES, MAX_FIELDS, MAX_PATH, MAX_SHOWN, MAX_STATES_BYTES, Kind

from .subject import Subject

#: Values that one job examines, in one state and altogether. These are counts, so a report does not depend on time.
_MOST_IN_STATE, _MOST = 20_000, 400_000
#: Levels below an attribute, items of a container that have fields of their own, and items of a set.
_DEEPEST, _MOST_ITEMS, _MOST_IN_SET = 8, 200, 2000
#: Bytes of an array, and digits of an integer in bits, that are read.
_MOST_BYTES, _MOST_BITS = 16 * 1024 * 1024, 4096
#: Lines of one call that are noted, because noting slows them down.
_MOST_LINES = 20_000

# Bound before any untrusted module can replace them. These read past what a class overrides.
_mro: Any = type.__dict__["__mro__"].__get__
_members: Any = type.__dict__["__dict__"].__get__
_name: Any = type.__dict__["__name__"].__get__
_flags: Any = type.__dict__["__flags__"].__get__
_module: Any = type.__dict__["__module__"].__get__
_hash: Any = xxhash.xxh3_128_hexdigest
_settrace, _gettrace = sys.settrace, sys.gettrace
_getstate, _get_state = random.getstate, np.random.get_state
_Generator, _RandomState, _Random = np.random.Generator, np.random.RandomState, random.Random
_dumps = json.dumps

_SIMPLE = frozenset({type(None), bool, float, complex, range, slice})
_NATIVE = {
    *(("pygame.rect", "Rect"), ("pygame", "Rect"), ("pygame.rect", "FRect"), ("pygame", "FRect")),
    *(("pygame.math", "Vector2"), ("pygame.math", "Vector3"), ("pygame", "Vector2"), ("pygame", "Vector3")),
}
#: The flag of a class that Python code has defined (``Py_TPFLAGS_HEAPTYPE``).
_HEAP = 1 << 9
_LISTS = (list, tuple, collections.deque)
_ITERATORS: dict[type, Callable[[Any], Iterator[Any]]] = {
    list: list.__iter__, tuple: tuple.__iter__, collections.deque: collections.deque.__iter__,
    set: set.__iter__, frozenset: frozenset.__iter__,
}  # fmt: skip


class Fields:
    """Reads the fields of an environment after each call, and sends those that changed.

    Args:
        subject: the environment's class.
        env: the instance.
    """

    def __init__(self, subject: Subject, env: Any) -> None:
        self._channel = subject.channel
        self._filename = subject.target.filename
        self._env = env.unwrapped
        self._own, self._modules = _own_modules(subject, type(self._env))
        self._known: dict[str, str] = {}
        self._lines: set[int] = set()
        self._noted = 0
        self._left = _MOST
        self._bytes = 0
        self._traced: Any = None

    def watching(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same call, of which the lines of the subject's file are noted."""

        def call(*args: Any, **kwargs: Any) -> Any:
            self._noted = 0
            before = _gettrace()
            _settrace(self._trace)
            try:
                return function(*args, **kwargs)
            finally:
                _settrace(before)

        return call

    def _trace(self, frame: Any, event: str, argument: Any) -> Any:
        if self._noted >= _MOST_LINES or frame.f_code.co_filename != self._filename:
            return None
        return self._trace_line

    def _trace_line(self, frame: Any, event: str, argument: Any) -> Any:
        self._noted += 1
        self._lines.add(frame.f_lineno)
        return self._trace_line if self._noted < _MOST_LINES else None

    def send(self) -> None:
        """Send the fields that changed, until the limits of the job are reached."""
        if self._left <= 0 or self._bytes >= MAX_STATES_BYTES:
            return
        state = _State(self._own, min(_MOST_IN_STATE, self._left))
        try:
            self._read(state)
        except BaseException:
            # A metaclass or a mapping of the subject can still interfere. It only loses its own evidence.
            self._left = 0
            return
        finally:
            used, found = state.used, dict(state.fields)
            state.clear()
        self._left -= used
        changed = [[path, *field] for path, field in found.items() if self._known.get(path) != field[0]]
        gone = [path for path in self._known if path not in found]
        self._known = {path: field[0] for path, field in found.items()}
        message = {"changed": changed, "gone": gone, "lines": sorted(self._lines)[:MAX_FIELD_LINES]}
        self._lines = set()
        data = _dumps(message).encode()
        self._bytes += len(data)
        if self._bytes < MAX_STATES_BYTES:
            self._channel.send(Kind.FIELDS, data)

    def _read(self, state: _State) -> None:
        """Read what is shared first: an attribute that refers to it is a consequence."""
        state.skip(self._env)
        state.leaf("random", repr(_getstate()), shown=False)
        state.leaf("numpy.random", _of_state(_get_state(legacy=False)), shown=False)
        for module, prefix in self._modules:
            for name, value in list(vars(module).items()):
                if type(name) is not str or name.startswith("__"):
                    continue
                if type in _mro(type(value)):
                    self._class(state, value, prefix)
                elif type(value) is FunctionType:
                    _defaults(state, value, f"{prefix}{name}")
                else:
                    state.walk(value, f"{prefix}{name}", 0)
        for name, value in _attributes(self._env):
            shown = "np_random" if name == "_np_random" else name
            state.walk(value, f"self.{shown}" if shown.isidentifier() else f"self[{shown!a}]", 0)

    def _class(self, state: _State, kind: type, prefix: str) -> None:
        if _module_of(kind) not in self._own:
            return
        name = f"{prefix}{_name(kind)}"
        for attribute, value in list(_members(kind).items()):
            inner = value.__func__ if type(value) in (staticmethod, classmethod) else value
            if type(inner) is FunctionType:
                _defaults(state, inner, f"{name}.{attribute}")
            elif not attribute.startswith("__") and not _is_descriptor(value):
                state.walk(value, f"{name}.{attribute}", 0)


class _State:
    """The fields of one state.

    Attributes:
        fields: the digest and the text of each path.
        used: how many values were examined.
    """

    def __init__(self, own: frozenset[str], most: int) -> None:
        self.fields: dict[str, tuple[str, str]] = {}
        self.used = 0
        self._own = own
        self._most = most
        #: The objects that were examined, by their ids. Each has one path.
        self._seen: dict[int, Any] = {}

    def clear(self) -> None:
        """Let go of all objects."""
        self._seen.clear()
        self.fields.clear()

    def skip(self, value: Any) -> None:
        self._seen[id(value)] = value

    def leaf(self, path: str, text: str | bytes, shown: bool | str = True) -> None:
        """Add a field.

        Args:
            path: its path.
            text: what its digest is made of.
            shown: its short text; by default the start of `text`, and with False none.
        """
        if len(self.fields) >= MAX_FIELDS or len(path) > MAX_PATH or not path.isprintable():
            return
        data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
        words = shown if isinstance(shown, str) else str(text) if shown else ""
        self.fields[path] = _hash(data), words[:MAX_SHOWN] if words.isprintable() else ""

    def walk(self, value: Any, path: str, depth: int) -> None:
        """Add the fields of a value."""
        self.used += 1
        if self.used > self._most or depth > _DEEPEST:
            return
        text = self._text(value)
        # The items of a long list have fields of their own, which change one by one.
        if text is not None and (len(text) <= MAX_SHOWN or type(value) not in _LISTS or len(value) > _MOST_ITEMS):
            self.leaf(path, text)
            return
        if id(value) in self._seen:
            return
        self._seen[id(value)] = value
        try:
            self._inside(value, path, depth, _mro(type(value)))
        except BaseException:
            # Nothing should raise. If something of the subject's does, its value has no fields.
            return

    def _inside(self, value: Any, path: str, depth: int, kinds: tuple[type, ...]) -> None:
        """Add the fields of a value that has parts."""
        if np.ndarray in kinds:
            self._array(value, path, depth)
        elif _Generator in kinds or _RandomState in kinds or _Random in kinds:
            self.leaf(path, _of_generator(value, kinds), shown=False)
        elif dict in kinds:
            self._dict(value, path, depth)
        elif set in kinds or frozenset in kinds:
            self._set(value, path, depth, set if set in kinds else frozenset)
        elif (base := next((kind for kind in _LISTS if kind in kinds), None)) is not None:
            self._list(value, path, depth, base)
        elif gymnasium.Space in kinds:
            for name, part in _attributes(value):
                if name == "_np_random" and part is not None:
                    self.walk(part, f"{path}.np_random", depth + 1)
        elif type(value) is itertools.count:
            self.leaf(path, repr(value))
        elif self._is_own(type(value), kinds):
            for name, part in _attributes(value):
                self.walk(part, f"{path}.{name}" if name.isidentifier() else f"{path}[{name!a}]", depth + 1)

    def _is_own(self, kind: type, kinds: tuple[type, ...]) -> bool:
        """Whether the attributes of an object are read."""
        data = any("__dataclass_fields__" in _members(one) for one in kinds)
        return data or SimpleNamespace in kinds or any(_module_of(one) in self._own for one in kinds)

    def _array(self, value: Any, path: str, depth: int) -> None:
        array = np.ndarray.view(value, np.ndarray)
        if array.dtype.hasobject:
            for number, item in enumerate(array.ravel()[:_MOST_ITEMS].tolist()):
                self.walk(item, f"{path}.flat[{number}]", depth + 1)
        elif array.nbytes <= _MOST_BYTES:
            small = array.size <= _MOST_ITEMS and array.dtype.kind in "biuf"
            what = f"an array of {array.dtype} {array.shape}"
            self.leaf(path, what.encode() + array.tobytes(), repr(array.tolist()) if small else what)

    def _list(self, value: Any, path: str, depth: int, base: Any) -> None:
        items = list(itertools.islice(_ITERATORS[base](value), _MOST_ITEMS))
        self.leaf(f"len({path})", str(base.__len__(value)))
        for number, item in enumerate(items):
            self.walk(item, f"{path}[{number}]", depth + 1)
        self._inherited(value, path, depth)

    def _dict(self, value: Any, path: str, depth: int) -> None:
        items = list(itertools.islice(dict.items(value), _MOST_ITEMS))
        self.leaf(f"len({path})", str(dict.__len__(value)))
        names = [self._text(key) for key, _ in items]
        for name, (_, item) in zip(names, items, strict=True):
            if name is not None:
                self.walk(item, f"{path}[{name}]", depth + 1)
        if len(names) > 1 and None not in names:
            self.leaf(f"list({path})", f"[{', '.join(map(str, names))}]")
        self._inherited(value, path, depth)

    def _set(self, value: Any, path: str, depth: int, base: Any) -> None:
        count = base.__len__(value)
        images = [self._image(item, depth) for item in itertools.islice(_ITERATORS[base](value), _MOST_IN_SET)]
        if count == len(images):
            self.leaf(path, f"{{{', '.join(sorted(images))}}}")
        else:
            self.leaf(f"len({path})", str(count))
        if count > 1:
            self.leaf(f"iter({path})", f"[{', '.join(images)}]")

    def _image(self, value: Any, depth: int) -> str:
        """An item of a set as text."""
        if (text := self._text(value)) is not None:
            return text
        inner = _State(self._own, self._most - self.used)
        inner._seen = self._seen
        inner.walk(value, "", depth + 1)
        self.used += inner.used
        return repr([(path, field[1] or field[0]) for path, field in inner.fields.items()])

    def _inherited(self, value: Any, path: str, depth: int) -> None:
        """The attributes that a container of the subject's own class has besides its items."""
        if type(value) not in (dict, *_ITERATORS) and self._is_own(type(value), _mro(type(value))):
            for name, part in _attributes(value):
                if name.isidentifier():
                    self.walk(part, f"{path}.{name}", depth + 1)

    def _text(self, value: Any, depth: int = 0) -> str | None:
        """A plain value, or a list or a tuple of some, as text; None for anything else."""
        kind = type(value)
        if kind is int:
            return repr(value) if value.bit_length() <= _MOST_BITS else hex(value)
        if kind in _SIMPLE:
            return repr(value)
        if kind is str or kind is bytes:
            return ascii(value)
        if kind is list or kind is tuple:
            return self._sequence(value, kind, depth)
        kinds = _mro(kind)
        if np.generic in kinds and _module_of(kind) == "numpy":
            return ascii(value.item())
        if enum.Enum in kinds:
            return f"{_name(kind)}.{ascii(_members_of(value).get('_name_'))[1:-1]}"
        if not _flags(kind) & _HEAP and (_module_of(kind), _name(kind)) in _NATIVE:
            return repr(value)
        return None

    def _sequence(self, value: Any, kind: type, depth: int) -> str | None:
        if depth > _DEEPEST or len(value) + self.used > self._most:
            return None
        texts = []
        for item in value:
            if (text := self._text(item, depth + 1)) is None:
                return None
            texts.append(text)
        self.used += len(value)
        inside = ", ".join(texts)
        return f"[{inside}]" if kind is list else f"({inside}{',' * (len(texts) == 1)})"


def _own_modules(subject: Subject, kind: type) -> tuple[frozenset[str], list[tuple[ModuleType, str]]]:
    """The names of the modules whose objects are read, and the modules whose globals are, each with a prefix."""
    folder = os.getcwd() + os.sep
    main = getattr(subject.target, "module", None) or sys.modules.get(_module_of(kind))
    project = [
        (module, f"{name}.")
        for name, module in list(sys.modules.items())
        if type(module) is ModuleType
        and module is not main
        and type(file := vars(module).get("__file__")) is str
        and file.startswith(folder)
    ]
    bases = {_module_of(one) for one in _mro(kind) if one not in (*_mro(gymnasium.Wrapper), object)}
    modules = [(main, ""), *project] if type(main) is ModuleType else project
    return frozenset(bases | {vars(module).get("__name__", "") for module, _ in modules}) - {"builtins"}, modules


def _module_of(kind: type) -> str:
    try:
        name = _module(kind)
    except AttributeError:
        return ""
    return name if type(name) is str else ""


def _is_descriptor(value: Any) -> bool:
    return any("__get__" in _members(kind) for kind in _mro(type(value)))


def _defaults(state: _State, function: FunctionType, path: str) -> None:
    """The default arguments of a function that are no plain values."""
    code = function.__code__
    names = code.co_varnames[: code.co_argcount]
    defaults = function.__defaults__ or ()
    given: Iterable[tuple[str, Any]] = zip(names[len(names) - len(defaults) :], defaults, strict=False)
    for name, value in [*given, *(function.__kwdefaults__ or {}).items()]:
        if type(value) not in _SIMPLE and type(value) not in (int, str, bytes):
            state.walk(value, f"{path}({name})", 0)


def _attributes(value: Any) -> list[tuple[str, Any]]:
    """The attributes in ``__dict__`` and ``__slots__`` of an object, without any method of its class."""
    found = list(_members_of(value).items())
    for kind in _mro(type(value)):
        for name, member in list(_members(kind).items()):
            if type(member) is MemberDescriptorType and _flags(kind) & _HEAP:
                try:
                    found.append((name, member.__get__(value)))
                except AttributeError:
                    continue
    return [(name, part) for name, part in found if type(name) is str]


def _members_of(value: Any) -> dict[str, Any]:
    """The ``__dict__`` of an object; empty if it has none, or if its class puts something else there."""
    descriptor = next((_members(kind)["__dict__"] for kind in _mro(type(value)) if "__dict__" in _members(kind)), None)
    if not isinstance(descriptor, GetSetDescriptorType | MemberDescriptorType):
        return {}
    found = descriptor.__get__(value)
    return found if type(found) is dict else {}


def _of_generator(value: Any, kinds: tuple[type, ...]) -> bytes | str:
    """The state of a random generator."""
    if _Generator in kinds:
        return _of_state(_Generator.bit_generator.__get__(value).state)
    if _RandomState in kinds:
        return _of_state(_RandomState.get_state(value, legacy=False))
    if random.SystemRandom in kinds:
        return ""
    # That of the class in Python reads an attribute of the object.
    return repr(_random.Random.getstate(value))


def _of_state(state: Any) -> bytes:
    """The state of a NumPy generator as bytes: a dictionary of numbers and arrays."""
    if isinstance(state, dict):
        return b"".join(str(name).encode() + _of_state(part) for name, part in state.items())
    return state.tobytes() if isinstance(state, np.ndarray) else ascii(state).encode()
