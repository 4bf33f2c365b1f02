"""Batches infos as Gymnasium's ``VectorEnv`` does, also where environments give one key values of different types."""

from __future__ import annotations

from typing import Any

import numpy as np
from envcraft_protocol.classes import type_name
from numpy.typing import NDArray

#: The dtypes of columns of Python's own numbers.
_PYTHON_DTYPES = {int: np.dtype(int), float: np.dtype(float), bool: np.dtype(bool)}
_MAX_DEPTH = 8


def add_info(batch: dict[str, Any], info: dict[str, Any], index: int, count: int) -> dict[str, Any]:
    """Add the info of environment `index` of `count` to a batch.

    Gymnasium's own ``_add_info`` chooses a column's dtype by the first value and casts the others to it, so that 0.5
    becomes 0 beside an integer. Environments of a corpus differ, so here a column becomes wide enough for all values.

    Args:
        batch: For each key an array of `count` values, and under ``_key`` a mask of the environments that have one.
        info: What one environment returned.
        index: Its row.
        count: The number of environments.

    Returns:
        The batch, changed in place.
    """
    for key, value in info.items():
        mask = batch.get(f"_{key}")
        if mask is None:
            mask = batch[f"_{key}"] = np.zeros(count, np.bool_)
        mask[index] = True
        column = batch.get(key)
        if isinstance(value, dict) and key != "final_obs" and (column is None or isinstance(column, dict)):
            batch[key] = add_info(column or {}, value, index, count)
            continue
        if column is None:
            column = batch[key] = _column(key, value, count)
        elif isinstance(column, dict) or not _fits(column, value):
            column = batch[key] = _widen(column, mask, _column(key, value, count))
        column[index] = value
    return batch


def plain(value: Any, depth: int = 0) -> Any:
    """Replace each object in `value` that is neither Python's nor NumPy's plain data by ``{"type": name}``.

    Only such values go from a worker process to the process that has the vector, which cannot import what the
    environment's file defines.
    """
    if value is None or type(value) in (bool, int, float, str, bytes):
        return value
    if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        return np.asarray(value) if isinstance(value, np.ndarray) else value
    if depth < _MAX_DEPTH:
        if isinstance(value, dict):
            keys = {key: key if type(key) in (int, str) else str(key) for key in value}
            return {keys[key]: plain(item, depth + 1) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item, depth + 1) for item in value]
    return {"type": type_name(value)}


def _column(key: str, value: Any, count: int) -> NDArray[Any]:
    """An array for the values of one key, by the first of them."""
    if key != "final_obs" and not _is_long(value):
        if type(value) in _PYTHON_DTYPES or isinstance(value, np.number):
            return np.zeros(count, type(value))
        if isinstance(value, np.ndarray):
            return np.zeros((count, *value.shape), value.dtype)
    return np.full(count, None, object)


def _fits(column: NDArray[Any], value: Any) -> bool:
    """Whether a column can hold a value unchanged."""
    if column.dtype == object:
        return True
    if type(value) in _PYTHON_DTYPES:
        return column.ndim == 1 and column.dtype == _PYTHON_DTYPES[type(value)] and not _is_long(value)
    numeric = isinstance(value, np.number | np.ndarray)
    return numeric and column.dtype == value.dtype and column.shape[1:] == value.shape


def _is_long(value: Any) -> bool:
    """Whether a value is an integer of more than 64 bits."""
    return type(value) is int and not -(2**63) <= value < 2**63


def _widen(column: NDArray[Any] | dict[str, Any], mask: NDArray[np.bool_], other: NDArray[Any]) -> NDArray[Any]:
    """An array with the values of `column` where `mask` is True, which can also hold the values of `other`."""
    if (
        not isinstance(column, dict)
        and column.shape == other.shape
        and {column.dtype.kind, other.dtype.kind} <= set("iuf")
    ):
        return column.astype(np.result_type(column, other))
    wide = np.full(len(mask), None, object)
    for index in np.flatnonzero(mask).tolist():
        wide[index] = _unbatch(column, index) if isinstance(column, dict) else column[index]
    return wide


def _unbatch(batch: dict[str, Any], index: int) -> dict[str, Any]:
    """The info of one environment in a batch."""
    keys = [key for key in batch if f"_{key}" in batch and batch[f"_{key}"][index]]
    return {key: _unbatch(batch[key], index) if isinstance(batch[key], dict) else batch[key][index] for key in keys}
