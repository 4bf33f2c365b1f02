"""A job's end of the data socket: collect messages for the host, and encode values as a layout and bytes."""

from __future__ import annotations

import json
import math
import os
import socket
import time
from itertools import islice
from json import encoder
from typing import Any

import numpy as np
from envcraft_protocol.classes import type_name
from envcraft_protocol.wire import (
    BLOCK,
    FRAME,
    HEADER,
    LONG,
    MAX_BLOCK,
    MAX_DEPTH,
    MAX_DIMENSIONS,
    MAX_INFO,
    MAX_ITEMS,
    MAX_JSON,
    MAX_LAYOUTS,
    MAX_OBSERVATION,
    MAX_PARTS,
    MAX_STEPS,
    RENDERED,
    SAME,
    SAME_INFO,
    STEP,
    VALUE,
    Kind,
    Type,
)

from . import frames
from .frames import Frames

#: A value as it was sent: the number of its layout, its bytes or its digest, and FRAME or 0.
Sent = tuple[int, bytes, int]

_BATCH = 256 * 1024
_FLUSH_SECONDS = 0.05
#: Maximum number of parts in one call, without those of one more message: the kernel accepts 1,024 (IOV_MAX).
_MOST = 1_000
_ONE_TOO_MANY = {"k": "other", "type": "a value of yet another shape, of too many"}
#: Maximum number of entries of a dictionary, list or set in a JSON image.
_MOST_ENTRIES = 1_000
_SIMPLE = frozenset({bool, str, type(None)})
# Bound before any untrusted module can replace them.
_isfinite = math.isfinite
_monotonic = time.monotonic
_dumps = json.dumps
_loads = json.loads
_writev = os.writev
_Array = np.ndarray
_RESET, _STEPS, _FLOAT, _BOOL = Kind.RESET, Kind.STEPS, Type.FLOAT, Type.BOOL
_digest = frames.digest
#: The encoder that ``json.dumps`` creates for each value, where Python has it; for dictionaries of plain values.
_make: Any = getattr(encoder, "c_make_encoder", None)
_chunks: Any = _make and _make(None, repr, encoder.encode_basestring_ascii, None, ": ", ", ", False, False, True)


class Channel:
    """Writes messages for the host.

    With `every_step` it sends each step at once, so the host knows exactly how far a job came. Without `phases` it does
    not even send the name of a call before the call: such a job runs again if anything fails.
    """

    def __init__(
        self, sock: socket.socket, every_step: bool = False, phases: bool = True, shown: Frames | None = None
    ) -> None:
        self._sock = sock
        self._descriptor = sock.fileno()
        self._phases = phases
        #: The unsent parts, which are not joined, and their size in bytes.
        self._waiting: list[bytes] = []
        self._size = 0
        self._flushed = _monotonic()
        self._every_step = every_step
        self._layouts: dict[str, int] = {}
        self._parts = 0
        #: The type and shape of the last array, and its layout's number.
        self._array: tuple[Any, Any, int] = (None, None, -1)
        self._frames = shown or Frames()
        #: The type and shape of the last frame, its layout's number, its seed, and whether its columns are read.
        self._frame: tuple[Any, Any, int, int, bool] = (None, None, -1, 0, False)
        #: The number of the last long value's layout, and the value.
        self._last: tuple[int, bytes] = (-1, b"")
        self._info: bytes | None = None
        #: The open block: its kind, records, bytes of observations and of infos, and the size of these two.
        self._kind = _STEPS
        self._records: list[bytes] = []
        self._values: list[bytes] = []
        self._infos: list[bytes] = []
        self._length = 0
        #: JSON of the actions that a policy chose and that are not sent, and its size.
        self._actions: list[str] = []
        self._chosen = 0
        #: The number of the last observation; that of the reset is 0.
        self.number = 0
        #: The last observation.
        self.sent: Sent = (-1, b"", 0)
        #: Number of calls of step() so far, on any instance, and of those that gave up the processor in a job that
        #: counts them.
        self.steps = 0
        self.waits = 0
        #: Processor time of the steps of such a job in seconds.
        self.busy = 0.0

    def send(self, kind: Kind, payload: bytes = b"", flush: bool = False) -> None:
        self._put(HEADER.pack(kind, len(payload)), payload, flush=flush)

    def _put(self, *parts: bytes, flush: bool = False) -> None:
        self._close()
        self._waiting += parts
        for part in parts:
            self._size += len(part)
        full = self._size >= _BATCH or len(self._waiting) >= _MOST
        if flush or full or self._every_step or _monotonic() - self._flushed > _FLUSH_SECONDS:
            self.flush()

    def _close(self) -> None:
        """Close the open block."""
        if not self._records and not self._actions:
            return
        actions = f"[{', '.join(self._actions)}]".encode() if self._actions else b""
        head = BLOCK.pack(len(self._records), len(actions))
        length = len(head) + len(self._records) * STEP.size + self._length + len(actions)
        header = HEADER.pack(self._kind, length)
        self._waiting.append(b"".join((header, head, *self._records, *self._values, *self._infos, actions)))
        self._size += len(header) + length
        self._kind = _STEPS
        self._records, self._values, self._infos, self._actions = [], [], [], []
        self._length = self._chosen = 0

    def send_json(self, kind: Kind, value: Any, flush: bool = False) -> None:
        self.send(kind, _dumps(value).encode(), flush)

    def phase(self, name: str) -> None:
        self.send_json(Kind.PHASE, name, flush=self._phases)

    def tick(self) -> None:
        """Report that the job is alive, at most twenty times per second."""
        if _monotonic() - self._flushed > _FLUSH_SECONDS:
            self.send(Kind.TICK, flush=True)

    def flush(self) -> None:
        self._close()
        waiting, self._waiting = self._waiting, []
        if waiting:
            self._write(waiting, self._size)
            self._size = 0
        self._flushed = _monotonic()

    def _write(self, parts: list[bytes], size: int) -> None:
        while size:
            sent = _writev(self._descriptor, parts)
            size -= sent
            if size:
                parts = [b"".join(parts)[sent:]]

    def ask(self) -> Any:
        """Request the next action from the host, and wait for it."""
        self.send(Kind.ASK, flush=True)
        _, length = HEADER.unpack(self._receive(HEADER.size))
        if length > MAX_JSON:
            raise ValueError(f"an action of {length} bytes")
        return _loads(self._receive(length))

    def _receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            part = self._sock.recv(size - len(data))
            if not part:
                raise EOFError("the host hung up")
            data += part
        return data

    def action(self, action: Any) -> None:
        """Report the action that a policy chose."""
        if self._kind is not _STEPS or self._chosen > MAX_JSON // 2:
            self._close()
        text = _dumps(action)
        self._actions.append(text)
        self._chosen += len(text)
        if self._every_step:
            self.flush()

    def step(
        self, kind: Kind, observation: Any, reward: Any, terminated: Any, truncated: Any, info: Any, seconds: float
    ) -> None:
        """Report what reset() or step() returned."""
        self.number = 0 if kind is _RESET else self.number + 1
        layout, data, flags = self.sent = self._value(observation)
        if flags:
            data += self._frames.picture(observation, self.number)
        elif self._said(layout, data):
            flags, data = SAME, b""
        text = encode_info(info)
        if text == self._info:
            flags, text = flags | SAME_INFO, b""
        else:
            self._info = text
        self._add(kind, flags, reward, terminated, truncated, seconds, layout, data, text)

    def after(self, reward: Any, terminated: Any, truncated: Any) -> None:
        """Report what a step after the episode's end returned, without its observation and info."""
        self._add(Kind.AFTER, 0, reward, terminated, truncated, 0.0, 0, b"", b"")

    def _add(
        self,
        kind: Kind,
        flags: int,
        reward: Any,
        terminated: Any,
        truncated: Any,
        seconds: float,
        layout: int,
        data: bytes,
        text: bytes,
    ) -> None:
        reward_type, number = (_FLOAT, reward) if type(reward) is float else _number(reward)
        ended_type, ended = (_BOOL, terminated) if type(terminated) is bool else flag(terminated)
        cut_type, cut = (_BOOL, truncated) if type(truncated) is bool else flag(truncated)
        micros = min(int(seconds * 1e6), 0xFFFFFFFF)
        flags |= ended | cut << 1
        length = len(data) + len(text)
        if self._records and (kind is not _STEPS or self._kind is not _STEPS or self._length + length > MAX_BLOCK):
            self._close()
        self._kind = kind
        self._records.append(
            STEP.pack(flags, ended_type, cut_type, reward_type, number, micros, layout, len(data), len(text))
        )
        if length:
            self._values.append(data)
            self._infos.append(text)
            self._length += length
        full = len(self._records) >= MAX_STEPS or self._length >= MAX_BLOCK
        if full or self._every_step or _monotonic() - self._flushed > _FLUSH_SECONDS:
            self.flush()

    def _mark(self, flag: int) -> bool:
        """Set a flag of the last record; False if it is sent already, or has the flag."""
        if not self._records or self._records[-1][0] & flag:
            return False
        record = self._records[-1]
        self._records[-1] = bytes((record[0] | flag,)) + record[1:]
        return True

    def render(self, frame: Any) -> None:
        """Report what render() returned after the last reset or step."""
        value = self._value(frame, rendered=True)
        if value[2]:
            if value == self.sent and self._mark(RENDERED):
                return
            self._send_value(Kind.RENDER, value, self._frames.picture(frame, self.number))
        else:
            self._send_value(Kind.RENDER, value)

    def is_resized(self, observation: Any) -> bool:
        """Whether an agent holds a resized copy of an observation."""
        return self._frames.is_resized(observation)

    def read(self, observation: Any) -> Sent:
        """What would be sent of an observation now."""
        return self._value(observation)

    def _send_value(self, kind: Kind, value: Sent, picture: bytes = b"") -> None:
        number, data, flags = value
        if not flags and self._said(number, data):
            flags, data = SAME, b""
        self._put(HEADER.pack(kind, VALUE.size + len(data) + len(picture)), VALUE.pack(flags, number), data, picture)

    def _said(self, layout: int, data: bytes) -> bool:
        """Whether a value repeats the last long one. If it is long itself, it becomes the last one."""
        if len(data) < LONG:
            return False
        same = self._last == (layout, data)
        self._last = layout, data
        return same

    def _value(self, value: Any, rendered: bool = False) -> Sent:
        """A value to be sent: of a frame the digest."""
        if type(value) is _Array:
            dtype, shape, number, seed, columns = self._frame
            if value.dtype is dtype and value.shape == shape:
                return number, _digest(value, seed, columns), FRAME
        described = self._frames.layout(value)
        known = described is not None
        if rendered and not known and frames.is_long_frame(value) and value.ndim == 3:
            # It is only compared with the observation, whatever that is.
            described = frames.describe(value)
        if described is None:
            return *self.encode(self._frames.adapted(value)), 0
        layout, seed, columns = described
        value = np.asarray(value)
        digest = _digest(value, seed, columns)
        key = _dumps(layout)
        number = self._layouts.get(key, -1)
        if number < 0:
            number, digest = self._announce(layout, key, digest)
        if not digest:
            return number, digest, 0
        if known:
            self._frame = value.dtype, value.shape, number, seed, columns
        return number, digest, FRAME

    def encode(self, value: Any) -> tuple[int, bytes]:
        """The number of the value's layout, after sending a new layout, and the value's bytes."""
        if type(value) is _Array:
            dtype, shape, number = self._array
            if value.dtype is dtype and value.shape == shape:
                return number, value.tobytes()
        layout, data = encode_value(value)
        if len(data) > MAX_OBSERVATION:
            layout, data = {"k": "other", "type": f"{type_name(value)} of {len(data)} bytes"}, b""
        key = _dumps(layout)
        number = self._layouts.get(key, -1)
        if number < 0:
            number, data = self._announce(layout, key, data)
        elif type(value) is _Array and layout["k"] == "array":
            # An array that cannot be described has no bytes.
            self._array = value.dtype, value.shape, number
        return number, data

    def _announce(self, layout: dict[str, Any], key: str, data: bytes) -> tuple[int, bytes]:
        """Send a layout; return its number and the value's bytes, which are empty if there are too many layouts."""
        parts = _parts(layout)
        if len(self._layouts) >= MAX_LAYOUTS - 1 or self._parts + parts >= MAX_PARTS or len(key) > MAX_JSON:
            layout, data, key, parts = _ONE_TOO_MANY, b"", "", 1
            if key in self._layouts:
                return self._layouts[key], data
        self._parts += parts
        number = self._layouts[key] = len(self._layouts)
        self.send_json(Kind.LAYOUT, layout)
        return number, data


def _parts(layout: dict[str, Any]) -> int:
    items = layout.get("items", ())
    return 1 + sum(_parts(item[1] if layout["k"] == "dict" else item) for item in items)


def encode_value(value: Any, depth: int = 0) -> tuple[dict[str, Any], bytes]:
    """Describe a value as a layout and its bytes. A value that cannot be described becomes the name of its type."""
    if depth > MAX_DEPTH:
        return {"k": "other", "type": "nested too deeply"}, b""
    if isinstance(value, np.ndarray):
        if not _is_plain(value.dtype):
            return {"k": "other", "type": f"ndarray of {value.dtype}"}, b""
        if value.ndim > MAX_DIMENSIONS or max(value.nbytes, *value.shape, 0) > MAX_OBSERVATION:
            return {"k": "other", "type": f"ndarray {value.shape} of {value.nbytes} bytes"}, b""
        return (
            {"k": "array", "dtype": value.dtype.str, "shape": list(value.shape)},
            np.ndarray.tobytes(value),
        )
    if isinstance(value, np.generic) and not isinstance(value, str):
        if not _is_plain(value.dtype):
            return {"k": "other", "type": f"NumPy {value.dtype}"}, b""
        return {"k": "scalar", "dtype": value.dtype.str}, value.tobytes()
    if isinstance(value, bool):
        return {"k": "bool"}, bytes([value])
    if isinstance(value, int) and -(2**63) <= value < 2**63:
        return {"k": "int"}, int(value).to_bytes(8, "little", signed=True)
    if isinstance(value, float):
        return {"k": "float"}, np.float64(value).tobytes()
    if isinstance(value, str) and len(value) <= MAX_INFO:
        data = value.encode("utf-8", "backslashreplace")
        return {"k": "str", "n": len(data)}, data
    if isinstance(value, list) and (numbers := _numbers(value)) is not None:
        return {"k": "numbers", "dtype": numbers.dtype.str, "shape": list(numbers.shape)}, numbers.tobytes()
    if isinstance(value, dict | list | tuple) and len(value) > MAX_ITEMS:
        return {"k": "other", "type": f"{type_name(value)} of {len(value)} items"}, b""
    if isinstance(value, dict):
        layouts, parts = [], []
        for key in value:
            layout, data = encode_value(value[key], depth + 1)
            layouts.append([str(key), layout])
            parts.append(data)
        return {"k": "dict", "items": layouts}, b"".join(parts)
    if isinstance(value, list | tuple):
        pairs = [encode_value(item, depth + 1) for item in value]
        kind = "tuple" if isinstance(value, tuple) else "list"
        return {"k": kind, "items": [layout for layout, _ in pairs]}, b"".join(data for _, data in pairs)
    return {"k": "other", "type": type_name(value)}, b""


def _numbers(value: list[Any]) -> np.ndarray[Any, Any] | None:
    """Nested lists of numbers as an array, so that the layout of a picture in lists is short."""
    try:
        numbers = np.array(value)
    except (ValueError, TypeError, OverflowError):
        return None
    fits = 0 < numbers.nbytes <= MAX_OBSERVATION and numbers.ndim <= MAX_DIMENSIONS
    return numbers if fits and numbers.dtype.kind in "biuf" else None


def _is_plain(dtype: np.dtype[Any]) -> bool:
    """Whether values of a type are numbers or text that their bytes represent completely."""
    return dtype.kind in "biufcSU" and dtype.itemsize > 0


def encode_info(info: Any) -> bytes:
    """Info as JSON of bounded size and depth. NaN and infinities are written as Python's json does."""
    if not info:
        return b""
    try:
        if _chunks is not None and _is_json(info):
            text = "".join(_chunks(info, 0)).encode()
        elif type(info) is dict and (length := _least(info)) > MAX_INFO:
            text = _dumps({"envcraft: too large": length}).encode()
        else:
            text = _dumps(jsonable(info)).encode()
    except (ValueError, TypeError, RecursionError) as error:
        text = _dumps({"envcraft: not encodable": type_name(error)}).encode()
    if len(text) > MAX_INFO:
        text = _dumps({"envcraft: too large": len(text)}).encode()
    return text


def _least(info: dict[Any, Any]) -> int:
    """A lower bound of the length of an info as JSON, found without encoding it. It counts no further than needed."""
    length, level = 0, [info]
    for _ in range(MAX_DEPTH):
        deeper: list[Any] = []
        for container in level:
            items = container.values() if type(container) is dict else container
            for item in islice(items, _MOST_ENTRIES):
                kind = type(item)
                if kind is str:
                    length += len(item)
                elif kind is dict or kind is list or kind is tuple:
                    length += min(len(item), _MOST_ENTRIES)
                    deeper.append(item)
                if length > MAX_INFO:
                    return length
        level = deeper
    return length


def _is_json(info: dict[Any, Any]) -> bool:
    """Whether a dictionary is its own JSON image, as nearly always; then no image is needed."""
    if type(info) is not dict or len(info) > _MOST_ENTRIES:
        return False
    for key, value in info.items():
        kind = type(value)
        if type(key) is not str:
            return False
        if kind is float:
            if not _isfinite(value):
                return False
        elif kind is int:
            if not -(2**63) <= value < 2**63:
                return False
        elif kind not in _SIMPLE or (kind is str and len(value) > MAX_INFO):
            return False
    return True


def jsonable(value: Any, depth: int = 0) -> Any:
    """A JSON image of any value: small arrays become lists, unknown values the name of their type."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return int(value) if -(2**63) <= value < 2**63 else str(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else repr(float(value))
    if depth >= MAX_DEPTH:
        return {"envcraft: nested": type_name(value)}
    if isinstance(value, np.generic):
        return jsonable(value.item(), depth + 1)
    if isinstance(value, np.ndarray):
        if value.size <= 64 and not value.dtype.hasobject:
            return jsonable(value.tolist(), depth + 1)
        import hashlib

        digest = "" if value.dtype.hasobject else hashlib.sha256(value.tobytes()).hexdigest()[:16]
        return {"array": [str(value.dtype), list(value.shape), digest]}
    if isinstance(value, dict):
        return {str(key): jsonable(item, depth + 1) for key, item in list(value.items())[:_MOST_ENTRIES]}
    if isinstance(value, list | tuple):
        return [jsonable(item, depth + 1) for item in value[:_MOST_ENTRIES]]
    if isinstance(value, set | frozenset):
        return {"set": sorted(_dumps(jsonable(item, depth + 1)) for item in list(value)[:_MOST_ENTRIES])}
    return {"type": type_name(value)}


def _number(value: Any) -> tuple[Type, float]:
    kind = _type(value)
    if kind <= Type.NUMPY_FLOAT:
        try:
            return kind, float(value)
        except OverflowError:
            return kind, math.inf
    return kind, 0.0


def flag(value: Any) -> tuple[Type, int]:
    """The type of a flag, and whether it holds, which an array says by its only item."""
    kind = _type(value)
    if kind == Type.ARRAY:
        return kind, int(value.size == 1 and value.dtype.kind in "biuf" and bool(value.item()))
    return kind, int(bool(value)) if kind <= Type.STR else 0


def _type(value: Any) -> Type:
    if isinstance(value, bool):
        return Type.BOOL
    if isinstance(value, float) and not isinstance(value, np.generic):
        return Type.FLOAT
    if isinstance(value, int):
        return Type.INT
    if isinstance(value, np.bool_):
        return Type.NUMPY_BOOL
    if isinstance(value, np.integer):
        return Type.NUMPY_INT
    if isinstance(value, np.floating):
        return Type.NUMPY_FLOAT
    if value is None:
        return Type.NONE
    if isinstance(value, str):
        return Type.STR
    if isinstance(value, np.ndarray):
        return Type.ARRAY
    containers = ((list, Type.LIST), (tuple, Type.TUPLE), (dict, Type.DICT))
    return next((kind for container, kind in containers if isinstance(value, container)), Type.OTHER)
