"""Decode values from the worker: a layout (JSON, read with bounds) and the raw bytes that fill it."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import xxhash
from envcraft_protocol.wire import array_identity
from numpy.typing import NDArray

from envcraft.errors import MalformedValue
from envcraft.text import with_article

MAX_BYTES = 8 * 1024 * 1024
_MAX_DEPTH = 9
_MAX_ITEMS = 4096
#: A dtype as ``dtype.str`` writes it. NumPy parses other strings as Python, and raises errors of many kinds.
_DTYPE = re.compile(r"[<>|][biufcSU][0-9]{1,9}")
#: Bytes of an array without its empty axes. NumPy refuses larger arrays even if they are empty.
_MAX_ARRAY = np.iinfo(np.intp).max
#: The dtype of each kind that has one without saying it.
_DTYPES = {"int": np.dtype("<i8"), "float": np.dtype("<f8"), "bool": np.dtype("?")}
#: The largest integer up to which a float64 holds all.
_MAX_EXACT = 2**53


class ValueCodec:
    """The layout of one value, which decodes its bytes.

    Attributes:
        size: bytes of the value.
        parts: layouts in this one, itself included.
        tag: identifies the layout in digests.
        plain_tag: the same without the types of its numbers.
        opaque: the worker sends only the type of the value, or of a part of it.
    """

    __slots__ = ("_numbers", "dtype", "items", "kind", "name", "opaque", "parts", "plain_tag", "shape", "size", "tag")

    size: int
    parts: int
    tag: int
    plain_tag: int
    opaque: bool
    _numbers: np.dtype[Any] | None

    def __init__(self, spec: Any, depth: int = 0) -> None:
        if not isinstance(spec, dict) or depth > _MAX_DEPTH:
            raise MalformedValue("a layout is not an object, or is nested too deeply")
        self.kind: str = str(spec.get("k"))
        self.dtype: np.dtype[Any] | None = None
        self.shape: tuple[int, ...] = ()
        self.items: list[tuple[str, ValueCodec]] = []
        self.name = ""
        if self.kind in ("array", "scalar", "numbers"):
            self.dtype = _dtype(spec.get("dtype"))
            self.shape = () if self.kind == "scalar" else _shape(spec.get("shape", []))
            if self.dtype.itemsize * math.prod(filter(None, self.shape)) > _MAX_ARRAY:
                raise MalformedValue(f"an array of shape {self.shape}")
            self.size = self.dtype.itemsize * math.prod(self.shape)
        elif self.kind in ("int", "float"):
            self.size = 8
        elif self.kind == "bool":
            self.size = 1
        elif self.kind == "str":
            self.size = _count(spec.get("n"))
        elif self.kind in ("dict", "tuple", "list"):
            for index, item in enumerate(_items(spec.get("items"))):
                if self.kind == "dict":
                    if not (isinstance(item, list) and len(item) == 2 and isinstance(item[0], str)):
                        raise MalformedValue("a dict layout without keys")
                    self.items.append((item[0], ValueCodec(item[1], depth + 1)))
                else:
                    self.items.append((str(index), ValueCodec(item, depth + 1)))
            self.size = sum(item.size for _, item in self.items)
        elif self.kind == "other":
            self.size = 0
            self.name = str(spec.get("type"))[:200]
        else:
            raise MalformedValue(f"layout kind {self.kind[:40]!r}")
        self.parts = 1 + sum(item.parts for _, item in self.items)
        # The type None has no bytes.
        unknown = self.kind == "other" and self.name != "NoneType"
        self.opaque = unknown or any(item.opaque for _, item in self.items)
        if self.size > MAX_BYTES:
            raise MalformedValue(f"a value of {self.size} bytes")
        if self.kind == "array":
            identity = array_identity(str(self.dtype), self.shape)
        else:
            parts = (self.kind, str(self.dtype), self.shape, self.name, [(name, item.tag) for name, item in self.items])
            identity = repr(parts).encode()
        self.tag = xxhash.xxh3_64_intdigest(identity)
        dtype = _DTYPES.get(self.kind, self.dtype)
        narrow = dtype is not None and dtype.kind in "biuf" and dtype.itemsize <= 8
        # The type of a picture is a part of it.
        self._numbers = dtype if narrow and not is_picture(self.shape, dtype) else None
        self.plain_tag = self.tag
        if self._numbers is not None or self.items:
            keys = [(name, item.plain_tag) for name, item in self.items]
            plain = ("plain", "" if self._numbers is not None else self.kind, self.shape, keys)
            self.plain_tag = xxhash.xxh3_64_intdigest(repr(plain).encode())

    def plain(self, data: bytes | memoryview) -> bytes | memoryview | None:
        """Return the bytes of the value with each number as a float64; None if a number is too large for that."""
        if self.items:
            parts, offset = [], 0
            for _, item in self.items:
                part = item.plain(data[offset : offset + item.size])
                if part is None:
                    return None
                parts.append(part)
                offset += item.size
            return b"".join(parts)
        dtype = self._numbers
        if dtype is None or dtype == _DTYPES["float"]:
            return data
        numbers = np.frombuffer(data, dtype)
        large = dtype.kind in "iu" and dtype.itemsize == 8 and numbers.size
        if large and not -_MAX_EXACT <= numbers.min() <= numbers.max() <= _MAX_EXACT:
            return None
        # A signalling NaN becomes a quiet one.
        with np.errstate(invalid="ignore"):
            return numbers.astype("<f8").tobytes()

    def decode(self, data: bytes | memoryview) -> Any:
        """Build the value. Raises MalformedValue if the number of bytes is not :attr:`size`."""
        if len(data) != self.size:
            raise MalformedValue(f"{len(data)} bytes for a value of {self.size}")
        if self.dtype is not None and self.dtype.kind == "U":
            _check_characters(np.frombuffer(data, np.dtype("u4").newbyteorder(self.dtype.byteorder)))
        if self.kind == "array":
            return np.frombuffer(data, self.dtype).reshape(self.shape)
        if self.kind == "numbers":
            return np.frombuffer(data, self.dtype).reshape(self.shape).tolist()
        if self.kind == "scalar":
            return np.frombuffer(data, self.dtype)[0]
        if self.kind == "int":
            return int.from_bytes(data, "little", signed=True)
        if self.kind == "float":
            return float(np.frombuffer(data, "<f8")[0])
        if self.kind == "bool":
            return bool(data[0])
        if self.kind == "str":
            return bytes(data).decode("utf-8", "replace")
        if self.kind == "other":
            return None
        parts, offset = [], 0
        for name, item in self.items:
            parts.append((name, item.decode(data[offset : offset + item.size])))
            offset += item.size
        if self.kind == "dict":
            return dict(parts)
        values = [value for _, value in parts]
        return tuple(values) if self.kind == "tuple" else values

    def __str__(self) -> str:
        if self.kind == "array":
            return f"{with_article(self.dtype)} array of shape {self.shape}"
        if self.kind == "numbers":
            return f"nested Python lists of shape {self.shape}"
        if self.kind == "scalar":
            return f"a NumPy {self.dtype}"
        if self.kind == "other":
            return self.name
        if self.kind in ("dict", "tuple", "list"):
            return f"a {self.kind} of {len(self.items)}"
        return f"a Python {self.kind}"


def _dtype(name: Any) -> np.dtype[Any]:
    try:
        dtype = np.dtype(name) if isinstance(name, str) and _DTYPE.fullmatch(name) else None
    except (TypeError, ValueError):
        dtype = None
    if dtype is None or not dtype.itemsize:
        raise MalformedValue(f"dtype {str(name)[:40]!r}")
    return dtype


def _check_characters(numbers: NDArray[np.uint32]) -> None:
    """Raises MalformedValue if a number is not a Unicode character."""
    if numbers.size and numbers.max() > sys.maxunicode:
        raise MalformedValue("a text with invalid characters")


def _shape(value: Any) -> tuple[int, ...]:
    if not isinstance(value, list) or len(value) > 32:
        raise MalformedValue("a shape is not a short list")
    return tuple(_count(length) for length in value)


def _count(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_BYTES:
        raise MalformedValue(f"a length of {str(value)[:40]}")
    return value


def _items(value: Any) -> list[Any]:
    if not isinstance(value, list) or len(value) > _MAX_ITEMS:
        raise MalformedValue("items are not a list, or are too many")
    return value


def is_picture(shape: Sequence[int], dtype: Any) -> bool:
    """Whether arrays of this shape and dtype are grey or RGB frames: (H, W), (H, W, 1) or (H, W, 3) of uint8."""
    return dtype == np.uint8 and (len(shape) == 2 or (len(shape) == 3 and shape[2] in (1, 3))) and 0 not in shape
