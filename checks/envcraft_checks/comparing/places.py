"""Where two traces differ: the part of an observation, and the line that writes a key of info."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.model.rollout import Conditions, Rollout
from envcraft_checks.comparing.traces import diverge
from envcraft_checks.linting.program import program_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Divergence, Trace

#: Pairs of runs until one differs at the same step, because a difference by chance may not show again.
_TRIES = 3
#: Characters of a key that a message shows, and of a text in evidence.
_KEY, _TEXT = 40, 200


def located(subject: Subject, rollout: Rollout, under: Conditions, found: Divergence) -> Divergence:
    """Say which part of an observation differs.

    Args:
        subject: the environment.
        rollout: the episode, without conditions.
        under: the conditions under which the observation differs.
        found: the difference.

    Returns:
        The difference with its part and both values there; unchanged if another field differs, the worker cannot send
        the observation, or the budget has too few steps left.
    """
    kept = msgspec.structs.replace(rollout.cut(found.step), keep=found.step + 1)
    for _ in range(_TRIES if found.field == "observation" else 0):
        if not subject.affords(2 * found.step):
            break
        second = subject.rerun(kept.under(under))
        first = second.earlier if under.again else subject.rerun(kept)
        again = diverge(first, second, info=False) if first is not None else None
        if first is not None and again is not None and (again.step, again.field) == (found.step, found.field):
            return part(found, *(_observation(trace, found.step) for trace in (first, second)))
    return found


def _observation(trace: Trace, step: int) -> Any:
    """An observation; None if it was not kept, or observations of several kinds were."""
    kept = trace.values or trace.frames
    return kept[step] if len(kept) == len(trace.observations) > step else None


def part(found: Divergence, first: Any, second: Any) -> Divergence:
    """Name the part in which two observations differ, with both values at its first place.

    Args:
        found: the difference.
        first: one observation: an array, a number, a text, or dictionaries, tuples and lists of these.
        second: the other.
    """
    import dataclasses

    differing = list(_differing(first, second))
    if not differing:
        return found
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


def _leaf(found: Divergence, one: Any, two: Any) -> Divergence:
    """A difference with the values of two parts that have no parts of their own, if they are numbers or texts."""
    import dataclasses

    import numpy as np

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


def writing_line(subject: Subject, found: Divergence) -> int | None:
    """Return the only line that writes the differing key of info, outside environments that the judged one does not
    use; None if none or several do.
    """
    if found.field != "info" or not isinstance(found.first, dict) or (program := program_of(subject)) is None:
        return None
    key = next(iter(found.first), "").split(".")[0]
    others = program.classes.keys() - program.own_classes
    left_out = {node for name in others for node in ast.walk(program.classes[name])}
    lines = {node.lineno for each in program.nodes if each not in left_out for node in _written(each, key)}
    return lines.pop() if len(lines) == 1 else None


def _written(node: ast.AST, key: str) -> list[ast.expr]:
    """The values that a node of a syntax tree stores under a key."""
    if isinstance(node, ast.Dict):
        pairs = zip(node.keys, node.values, strict=True)
        return [value for name, value in pairs if isinstance(name, ast.Constant) and name.value == key]
    if isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign) and node.value is not None:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        slices = [target.slice for target in targets if isinstance(target, ast.Subscript)]
        return [part for part in slices if isinstance(part, ast.Constant) and part.value == key]
    if isinstance(node, ast.Call):
        return [keyword.value for keyword in node.keywords if keyword.arg == key]
    return []
