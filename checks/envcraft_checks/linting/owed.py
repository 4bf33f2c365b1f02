"""Rewards that step() decides, or changes of a score that it makes, after it has paid the reward of the step."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of

_RESULTS = 5


def owed_rewards(program: Program) -> Iterator[Suspect]:
    """Find what step() adds to a kept reward after it has paid that reward, in a branch that ends the episode."""
    step = program.method(program.env, "step")
    for end in step.nodes if step is not None else ():
        match end:
            case ast.Return(value=ast.Tuple(elts=[_, ast.Name(id=reward), *flags, _])) if step is not None:
                over = alternatives(step, flags)
                for node, field, paid in _kept(step, reward, end):
                    if _ends(program, step, node, over) and not _pays_too(program, node, reward):
                        words = f"changes self.{field} after line {paid} has added it to the reward"
                        yield Suspect(line(node), f"{words}, and the episode ends in this step")


def early_differences(program: Program) -> Iterator[Suspect]:
    """Find a reward that is the change of an attribute since the last step, computed before this step changes it: what
    the last step of an episode earns is never paid.
    """
    step = program.method(program.env, "step")
    for node in step.nodes if step is not None else ():
        match node:
            case ast.Assign(targets=[ast.Name(id=reward)], value=ast.BinOp(left=now, op=ast.Sub(), right=before)):
                pass
            case _:
                continue
        assert step is not None
        field, kept = step.field(now), step.field(before)
        if not (field and kept and _is_always_returned(step, reward)):
            continue
        stored = [
            each for target, value, each in step.bindings if step.field(target) == kept and step.field(value) == field
        ]
        later = [each for each in step.nodes if line(each) > max(map(line, [node, *stored]))]
        if len(stored) != 1 or any(
            isinstance(each, ast.Name) and each.id == reward and isinstance(each.ctx, ast.Store) for each in later
        ):
            continue
        for call in later:
            called = program.called(call, step) if isinstance(call, ast.Call) else None
            changed = program.changed(called.name) if called is not None else set()
            if called is not None and field in changed and kept not in changed:
                words = f"changes self.{field} by {called.name}() after line {line(node)} has paid its change"
                yield Suspect(line(call), f"{words}, so the last step of an episode is not paid")
                return


def _is_always_returned(step: Function, reward: str) -> bool:
    """Whether each return of step() gives this name, alone or converted, as the reward."""
    rewards = [
        each.value.elts[1]
        for each in step.nodes
        if isinstance(each, ast.Return) and isinstance(each.value, ast.Tuple) and len(each.value.elts) == _RESULTS
    ]
    plain = [each.args[0] if isinstance(each, ast.Call) and len(each.args) == 1 else each for each in rewards]
    return bool(plain) and all(isinstance(each, ast.Name) and each.id == reward for each in plain)


def _ends(program: Program, step: Function, node: ast.AST, over: set[str]) -> bool:
    """Whether a statement stands in a branch whose test is one of those that end the episode, or that sets a flag."""
    while node is not step.node:
        parent = program.parents[node]
        if isinstance(parent, ast.If) and node in parent.body:
            tests = parent.test.values if isinstance(parent.test, ast.BoolOp) else [parent.test]
            every = not isinstance(parent.test, ast.BoolOp) or isinstance(parent.test.op, ast.And)
            flags = {
                ast.unparse(one.targets[0]) for one in parent.body if isinstance(one, ast.Assign) and _is_true(one)
            }
            if flags & over or (every and any(ast.unparse(test) in over for test in tests)):
                return True
        node = parent
    return False


def _is_true(node: ast.Assign) -> bool:
    return isinstance(node.value, ast.Constant) and node.value.value is True


def alternatives(step: Function, flags: list[ast.expr]) -> set[str]:
    """The expressions, as texts, each of which makes one of these flags true."""
    found: set[str] = set()
    waiting = [*flags]
    while waiting:
        one = waiting.pop()
        if isinstance(one, ast.Call) and name_of(one) in ("bool", "bool_"):
            waiting += one.args
        elif isinstance(one, ast.BoolOp) and isinstance(one.op, ast.Or):
            waiting += one.values
        elif not isinstance(one, ast.Constant) and (text := ast.unparse(one)) not in found:
            found.add(text)
            waiting += [
                value for target, value, _ in step.bindings if value is not None and ast.unparse(target) == text
            ]
    return found


def _pays_too(program: Program, node: ast.AST, reward: str) -> bool:
    """Whether the branch of a statement changes the reward of the step, too."""
    branch = ast.walk(program.parents[node])
    return any(isinstance(one, ast.Name) and one.id == reward and isinstance(one.ctx, ast.Store) for one in branch)


def _paid(step: Function, reward: str) -> Iterator[tuple[str, int]]:
    """The attributes that step() adds to the reward, each with the line that does it."""
    sums = [(node.target, node.value, node) for node in step.nodes if isinstance(node, ast.AugAssign)]
    for target, value, node in [*step.bindings, *sums]:
        if isinstance(target, ast.Name) and target.id == reward and (field := step.field(value)):
            yield field, line(node)


def _kept(step: Function, reward: str, end: ast.Return) -> Iterator[tuple[ast.AST, str, int]]:
    """The statements that put a number into an attribute after the reward has its last use of it.

    Yields:
        The statement, the attribute, and the line that adds the attribute to the reward.
    """
    for field, paid in _paid(step, reward):
        last = max(line(node) for node in step.nodes if step.field(node) == field and _is_read(node))
        for node in step.nodes:
            if isinstance(node, ast.Assign | ast.AugAssign) and max(paid, last) < line(node) < line(end):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                empty = isinstance(node.value, ast.Constant) and not node.value.value
                if any(step.field(target) == field for target in targets) and not empty:
                    yield node, field, paid


def _is_read(node: ast.AST) -> bool:
    return isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)
