"""Statements that do nothing: branches that never run, and assignments that come too late."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence

from .program import Function, Program, Suspect, line, name_of

#: Calls that give the same result twice in a row.
_PURE = frozenset({"abs", "bool", "float", "int", "isinstance", "len", "max", "min", "round", "sum", "tuple"})
#: The places of the reward and the flags in what step() returns.
_NUMBERS = (1, 2, 3)
_LENGTH = 5


def repeated_tests(program: Program) -> Iterator[Suspect]:
    """Find branches of a chain whose test an earlier branch has already answered."""
    computed = {
        one.name
        for owner in program.classes
        for one in program.methods(owner)
        if any("property" in name_of(decorator) for decorator in one.node.decorator_list)
    }
    for function in program.play:
        for node in function.nodes:
            if isinstance(node, ast.If | ast.IfExp) and not _continues(program.parents[node], node):
                yield from _chain(program, function, node, computed)
            elif isinstance(node, ast.Match):
                yield from _cases(node)


def _continues(parent: ast.AST, node: ast.AST) -> bool:
    """Whether a node is the rest of a chain."""
    return isinstance(parent, ast.If | ast.IfExp) and (parent.orelse is node or parent.orelse == [node])


def _chain(program: Program, function: Function, node: ast.AST | None, computed: set[str]) -> Iterator[Suspect]:
    earlier: dict[str, ast.If | ast.IfExp] = {}
    while isinstance(node, ast.If | ast.IfExp):
        if _is_fixed(program, function, node.test, computed):
            first = _answered(node.test, earlier)
            if first is not None and not _same(first, node):
                words = f"tests {ast.unparse(node.test)[:60]}, which never holds here: line {line(first)} has tested it"
                yield Suspect(line(node.test), words)
            for one in _parts(node.test):
                earlier.update((text, node) for text in _texts(one) if text not in earlier)
        else:
            # A call may change what was tested.
            earlier.clear()
        rest = node.orelse
        node = rest if isinstance(rest, ast.IfExp) else rest[0] if isinstance(rest, list) and len(rest) == 1 else None


def _is_fixed(program: Program, function: Function, test: ast.expr, computed: set[str]) -> bool:
    """Whether a test has the same result if it is made twice."""
    for node in ast.walk(test):
        match node:
            case ast.Call() if program.path(node.func, function) not in {f"builtins.{name}" for name in _PURE}:
                return False
            case ast.NamedExpr() | ast.Await() | ast.Yield() | ast.Lambda():
                return False
            case ast.Attribute(attr=attr) if attr in computed:
                return False
    return True


def _answered(test: ast.expr, earlier: dict[str, ast.If | ast.IfExp]) -> ast.If | ast.IfExp | None:
    """The branch that runs whenever a test holds."""
    if isinstance(test, ast.BoolOp):
        found = [_answered(one, earlier) for one in test.values]
        known = [one for one in found if one is not None]
        enough = known and (isinstance(test.op, ast.And) or len(known) == len(found))
        return known[0] if enough else None
    texts = _texts(test)
    return earlier[texts[0]] if texts and all(text in earlier for text in texts) else None


def _parts(test: ast.expr) -> list[ast.expr]:
    """The parts of a test, any of which makes it true."""
    if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.Or):
        return [part for one in test.values for part in _parts(one)]
    return [test]


def _texts(test: ast.expr) -> list[str]:
    """A test as text: one for each value if it compares with several."""
    match test:
        case ast.Compare(left=left, ops=[ast.Eq()], comparators=[right]):
            return [" == ".join(sorted((ast.unparse(left), ast.unparse(right))))]
        case ast.Compare(left=left, ops=[ast.In()], comparators=[ast.Tuple(elts=elts) | ast.List(elts=elts)]):
            return [" == ".join(sorted((ast.unparse(left), ast.unparse(one)))) for one in elts]
    return [ast.unparse(test)]


def _same(first: ast.If | ast.IfExp, second: ast.If | ast.IfExp) -> bool:
    """Whether a branch does what the first one does, or nothing."""
    if isinstance(first, ast.IfExp) or isinstance(second, ast.IfExp):
        return ast.dump(_body(first)[0]) == ast.dump(_body(second)[0])
    idle = all(isinstance(one, ast.Pass | ast.Raise) for one in second.body)
    return idle or [ast.dump(one) for one in first.body] == [ast.dump(one) for one in second.body]


def _body(node: ast.If | ast.IfExp) -> Sequence[ast.AST]:
    return [node.body] if isinstance(node, ast.IfExp) else node.body


def _cases(node: ast.Match) -> Iterator[Suspect]:
    seen: dict[str, ast.match_case] = {}
    for case in node.cases:
        patterns = case.pattern.patterns if isinstance(case.pattern, ast.MatchOr) else [case.pattern]
        texts = [ast.unparse(one) for one in patterns]
        if all(isinstance(one, ast.MatchValue | ast.MatchSingleton) for one in patterns):
            first = seen.get(texts[0])
            same = first is not None and list(map(ast.dump, first.body)) == list(map(ast.dump, case.body))
            if first is not None and not same and all(text in seen for text in texts):
                words = f"has case {' | '.join(texts)[:40]}, which never runs: line {line(first.pattern)} has it before"
                yield Suspect(line(case.pattern), words)
        if case.guard is None:
            seen.update((text, case) for text in texts if text not in seen)


def late_results(program: Program) -> Iterator[Suspect]:
    """Find what step() assigns after it has built the tuple that it returns, and reads nowhere."""
    step = program.method(program.env, "step")
    if step is None or any(isinstance(node, ast.Lambda | ast.FunctionDef | ast.Nonlocal) for node in step.nodes):
        return
    for node in step.nodes:
        for block in (getattr(node, name, None) for name in ("body", "orelse")):
            if isinstance(block, list):
                yield from _late(block)
    yield from _late(step.node.body)


def _late(block: list[ast.stmt]) -> Iterator[Suspect]:
    for start, built in enumerate(block):
        match built:
            case ast.Assign(targets=[ast.Name(id=result)], value=ast.Tuple(elts=elts)) if len(elts) == _LENGTH:
                after = _until_returned(block[start + 1 :], result)
                for change, name in _changes(after, elts):
                    words = (
                        f"changes {name} after line {line(built)} has built the result, so the result lacks the change"
                    )
                    yield Suspect(line(change), words)


def _until_returned(block: list[ast.stmt], result: str) -> list[ast.stmt]:
    """The statements before the one of the same block that returns a name; none if the name is bound anew."""
    for number, one in enumerate(block):
        match one:
            case ast.Return(value=ast.Name(id=name)) if name == result:
                bound = any(_is_name(node, result, ast.Store) for each in block[:number] for node in ast.walk(each))
                return [] if bound else block[:number]
    return []


def _changes(block: list[ast.stmt], elts: list[ast.expr]) -> Iterator[tuple[ast.stmt, str]]:
    """Assignments to parts of a result that nothing else in a block reads."""
    numbers = {one.id for place in _NUMBERS for one in ast.walk(elts[place]) if isinstance(one, ast.Name)}
    whole = {one.id for one in elts if isinstance(one, ast.Name)}
    every = [node for each in block for node in ast.walk(each)]
    for node in every:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)]) if name in numbers | whole:
                pass
            # An observation and info may change in place.
            case ast.AugAssign(target=ast.Name(id=name)) if name in numbers:
                pass
            case _:
                continue
        own = set(ast.walk(node))
        if not any(_is_name(one, name, ast.Load) for one in every if one not in own):
            yield node, name


def _is_name(node: ast.AST, name: str, context: type[ast.expr_context]) -> bool:
    return isinstance(node, ast.Name) and node.id == name and isinstance(node.ctx, context)
