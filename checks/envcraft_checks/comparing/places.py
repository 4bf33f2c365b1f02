"""Where two traces differ: an episode again with its observations, and the line that writes a key of info."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.judging.differences import part
from envcraft.model.rollout import Conditions, Rollout
from envcraft_checks.comparing.traces import diverge
from envcraft_checks.linting.program import program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Divergence, Trace

#: Pairs of runs until one differs at the same step, because a difference by chance may not show again.
_TRIES = 3


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
