"""Info dictionaries as bytes between a vector's processes: plain values and NumPy's, and nothing is unpickled."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from envcraft_runtime.classes import type_name

_SCALAR, _ARRAY = 1, 2
#: Kinds of dtypes whose bytes are their values.
_KINDS = "biufcSU"


def encode(value: Any) -> bytes:
    """Give msgpack. Objects other than dicts, lists, tuples, numbers, text and NumPy's become ``{"type": name}``."""
    try:
        return _encoder.encode(value)
    except (OverflowError, RecursionError, ValueError, TypeError):
        # An integer of more than 64 bits, a structure that holds itself, keys of no type that msgpack has.
        return _encoder.encode(_tamed(value, 0))


def decode(data: bytes) -> Any:
    """Read what :func:`encode` wrote. Raises msgspec.DecodeError, ValueError."""
    return _decoder.decode(data)


def _hook(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in _KINDS and value.dtype.itemsize:
        told = msgspec.msgpack.encode((value.dtype.str, list(value.shape), np.ndarray.tobytes(value)))
        return msgspec.msgpack.Ext(_ARRAY, told)
    if isinstance(value, np.generic) and not value.dtype.itemsize:
        # Empty text, which has no bytes of its dtype.
        return value.item()
    if isinstance(value, np.generic) and value.dtype.kind in _KINDS:
        return msgspec.msgpack.Ext(_SCALAR, msgspec.msgpack.encode((value.dtype.str, [], value.tobytes())))
    return {"type": type_name(value)}


def _ext(code: int, data: memoryview) -> Any:
    dtype, shape, content = msgspec.msgpack.decode(data, type=tuple[str, list[int], bytes])
    kind = np.dtype(dtype)
    if kind.kind not in _KINDS or code not in (_SCALAR, _ARRAY):
        raise ValueError(f"a value of dtype {dtype}, code {code}")
    array = np.frombuffer(content, kind).reshape(shape)
    return array[()] if code == _SCALAR else array.copy()


_encoder = msgspec.msgpack.Encoder(enc_hook=_hook)
_decoder = msgspec.msgpack.Decoder(ext_hook=_ext)


def _tamed(value: Any, depth: int) -> Any:
    """What cannot be encoded, with the parts at fault in words."""
    if depth > 8:
        return {"type": type_name(value)}
    if isinstance(value, dict):
        return {str(key): _tamed(item, depth + 1) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_tamed(item, depth + 1) for item in value]
    try:
        _encoder.encode(value)
    except (OverflowError, RecursionError, ValueError, TypeError):
        return str(value) if type(value) is int else {"type": type_name(value)}
    return value
