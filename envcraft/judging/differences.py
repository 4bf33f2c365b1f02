"""In which part two observations differ, and by which values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from envcraft.model.trace import Divergence

#: Characters of a key that a message shows, and of a text in evidence.
_KEY, _TEXT = 40, 200


def part(found: Divergence, first: Any, second: Any) -> Divergence:
    """Name the part in which two observations differ, with both values at its first place.

    A part whose values are equal and have other types counts only if no part has other values, with both types.

    Args:
        found: the difference.
        first: one observation: an array, a number, a text, or dictionaries, tuples and lists of these.
        second: the other.
    """
    import dataclasses

    differing = list(_differing(first, second))
    if not differing:
        return found
    differing = [each for each in differing if not _equal(*each[1:])] or differing
    path, one, two = differing[0]
    inner = _leaf(found, one, two)
    if path:
        several = f"{len(differing)} parts, first in " if len(differing) > 1 else ""
        inner = dataclasses.replace(inner, where=f"in {several}{path}{f' {inner.where}' if inner.where else ''}")
    return inner


def _differing(one: Any, two: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """The parts without parts of their own that differ, each with its keys as an expression indexes it."""
    if isinstance(one, dict) and isinstance(two, dict) and one.keys() == two.keys():
        for key in one:
            yield from _differing(one[key], two[key], f"{path}[{key[:_KEY]!r}]")
    elif isinstance(one, list | tuple) and type(one) is type(two) and len(one) == len(two):
        for number, pair in enumerate(zip(one, two, strict=True)):
            yield from _differing(*pair, f"{path}[{number}]")
    elif not _same(one, two):
        yield path, one, two


def _same(one: Any, two: Any) -> bool:
    """Whether two parts are equal; unequal types of Python are not, and NaN equals itself."""
    import numpy as np

    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray):
        same = one.shape == two.shape and one.dtype == two.dtype
        return same and bool(((one == two) | ((one != one) & (two != two))).all())
    # Containers that get here have other keys or lengths.
    if isinstance(one, np.ndarray | dict | list | tuple):
        return False
    return type(one) is type(two) and bool(one == two or (one != one and two != two))


def _equal(one: Any, two: Any) -> bool:
    """Whether two parts are numbers or arrays with equal values, of any types. NaN equals itself."""
    import numpy as np

    if not all(isinstance(each, np.ndarray | np.generic | int | float) for each in (one, two)):
        return False
    one, two = np.asarray(one), np.asarray(two)
    return one.shape == two.shape and bool(((one == two) | ((one != one) & (two != two))).all())


def _leaf(found: Divergence, one: Any, two: Any) -> Divergence:
    """A difference with the values of two parts that have no parts of their own, if they are numbers or texts."""
    import dataclasses

    import numpy as np

    if _equal(one, two):
        types = (str(each.dtype) if isinstance(each, np.ndarray) else type(each).__name__ for each in (one, two))
        return dataclasses.replace(found, first=next(types), second=next(types), where="in its type")
    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray):
        numbers = one.dtype.kind in "biuf" and two.dtype.kind in "biuf"
        return region(found, one, two) if numbers and one.shape == two.shape else found
    values = [value.item() if isinstance(value, np.generic) else value for value in (one, two)]
    if not all(isinstance(value, str | int | float) for value in values):
        return found
    shown = [value[:_TEXT] if isinstance(value, str) else value for value in values]
    return dataclasses.replace(found, first=shown[0], second=shown[1])


def region(found: Divergence, first: NDArray[Any], second: NDArray[Any]) -> Divergence:
    """Name the part in which two arrays of one shape differ, with both values at its first place."""
    import dataclasses

    import numpy as np

    from envcraft.spaces.codec import is_picture

    differing = ~((first == second) | ((first != first) & (second != second)))
    places = np.argwhere(
        differing.any(axis=2) if first.ndim == 3 and is_picture(first.shape, first.dtype) else differing
    )
    if not len(places):
        return found
    at = tuple(places[0].tolist())
    if is_picture(first.shape, first.dtype):
        (top, left), (bottom, right) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
        where = f"in rows {top} to {bottom} and columns {left} to {right}, first at {list(at)}"
    else:
        where = (
            f"at {list(at)}" if len(places) == 1 else f"in {len(places)} of {first.size} values, first at {list(at)}"
        )
    return dataclasses.replace(found, first=first[at].tolist(), second=second[at].tolist(), where=where)
