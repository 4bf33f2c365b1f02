"""Which statements of a source were reached by all play together, as the workers claim.

The claim is untrusted. It is used for warnings and to steer searches, and decides no error.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from envcraft.model.target import Target, imports, nodes, parse, walk

#: The most marks of a source.
_MOST = 2_000
#: Modules that look into code: they could see marks, or could not compile code with marks.
_LOOKING = frozenset({"ast", "dis", "inspect", "jax", "marshal", "numba", "taichi", "torch", "triton"})

#: What an assignment to a name with this last word does.
_EFFECTS = {
    **dict.fromkeys(("reward", "rewards", "score"), "pay"),
    **dict.fromkeys(("success", "won", "win", "victory", "solved"), "win"),
    **dict.fromkeys(("terminated", "done", "over", "gameover", "lost", "lose", "dead", "died", "finished"), "end"),
}
#: Names in conditions of code that play need not reach: pictures for a person, debugging, wrong arguments.
_BESIDE = re.compile(r"render|debug|verbose|human|__name__|contains|isinstance|hasattr|callable|action_space", re.I)
#: The last word of names that count time.
_TIME = frozenset({
    "step", "steps", "t", "time", "timer", "tick", "ticks", "frame", "frames", "turn", "turns", "moves", "elapsed",
    "clock", "horizon",
})  # fmt: skip
_ORDER = {"win": 0, "pay": 1, "end": 2}
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_COMPOUND = (
    ast.If, ast.For, ast.AsyncFor, ast.While, ast.With, ast.AsyncWith, ast.Try, ast.TryStar, ast.Match, ast.ClassDef,
    *_FUNCTIONS,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Statement:
    """A simple statement of a function.

    Attributes:
        line: its first line.
        last: its last line.
        column: in bytes of UTF-8.
        suite: the number of the suite that it belongs to.
        effects: what it does for the episode, of "win", "pay" and "end"; empty also where play need not come.
    """

    line: int
    last: int
    column: int
    suite: int
    effects: frozenset[str]


@dataclass(slots=True)
class _Function:
    """A function of the source: its name, the names that it mentions where play may come, and its marked statements."""

    name: str
    mentions: set[str]
    statements: list[Statement]


@dataclass(frozen=True, slots=True)
class Range:
    """Lines that were never reached, and what they do."""

    first: int
    last: int
    effects: frozenset[str]

    def __str__(self) -> str:
        lines = f"line {self.first}" if self.first == self.last else f"lines {self.first}-{self.last}"
        effects = sorted(self.effects, key=_ORDER.__getitem__)
        ending = "" if self.first != self.last else "s"
        return f"{lines}, which {' and '.join(effect + ending for effect in effects)}"


class Coverage:
    """The marked statements of a target, and which of them were reached. Only a file has any.

    Attributes:
        places: line and column of each mark.
    """

    def __init__(self, target: Target) -> None:
        self._functions: list[_Function] = []
        self._reached: set[tuple[int, int]] = set()
        #: Whether a job has said what it reached.
        self.known = False
        try:
            tree = parse("" if target.installed else target.text)
            if not _LOOKING.intersection(imports(tree)):
                self._functions = list(_functions(tree))
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            self._functions = []
        places = {(each.line, each.column) for function in self._functions for each in function.statements}
        self.places = sorted(places) if len(places) <= _MOST else []

    def add(self, reached: str) -> None:
        """Add what a job says: a digit for each mark."""
        self.known |= bool(reached)
        self._reached.update(place for place, digit in zip(self.places, reached, strict=False) if digit == "1")

    def missed(self) -> list[Range]:
        """The lines that ``step()`` could come to, that pay, win or end the episode, and that were never reached."""
        if not self.known or not self.places:
            return []
        missed = [
            each
            for function in self._from_step()
            for each in function.statements
            if each.effects and (each.line, each.column) not in self._reached
        ]
        return list(_ranges(sorted(missed, key=lambda each: (each.line, each.column))))

    def _from_step(self) -> list[_Function]:
        """The functions that ``step()`` may call: those whose names are mentioned, in turn."""
        named: dict[str, list[_Function]] = {}
        for function in self._functions:
            named.setdefault(function.name, []).append(function)
        reachable: list[_Function] = []
        names = ["step"]
        while names:
            # Of several functions of one name, some may be those of a class that is not in use.
            found = named.pop(names.pop(), [])
            reachable += found if len(found) == 1 else filter(self._is_entered, found)
            names += {name for function in found for name in function.mentions if name in named}
        return reachable

    def _is_entered(self, function: _Function) -> bool:
        return any((each.line, each.column) in self._reached for each in function.statements)


def _ranges(missed: Iterable[Statement]) -> Iterator[Range]:
    open_: list[Statement] = []
    for each in missed:
        if open_ and each.suite != open_[-1].suite and each.line > open_[-1].last + 1:
            yield _range(open_)
            open_ = []
        open_.append(each)
    if open_:
        yield _range(open_)


def _range(statements: list[Statement]) -> Range:
    effects = frozenset().union(*(each.effects for each in statements))
    return Range(statements[0].line, max(each.last for each in statements), effects)


def _functions(tree: ast.Module) -> Iterator[_Function]:
    fixed = _Fixed(tree)
    suites = iter(range(10**9))
    for node in nodes(tree):
        if isinstance(node, _FUNCTIONS):
            suite = _Suites(fixed, suites, node)
            statements = list(suite.marked())
            yield _Function(node.name, suite.mentions, statements)


def _mentions(tree: ast.AST) -> set[str]:
    every = walk(tree)
    names = {node.attr for node in every if isinstance(node, ast.Attribute)}
    return names | {node.id for node in every if isinstance(node, ast.Name)}


def _own(node: ast.stmt) -> Iterator[ast.AST]:
    """A statement without the suites inside it."""
    if not isinstance(node, _COMPOUND):
        yield node
        return
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr | ast.withitem):
            yield child


class _Fixed:
    """The attributes that only the constructor sets: options, which play cannot change."""

    def __init__(self, tree: ast.Module) -> None:
        self._changed: set[str] = set()
        for function in nodes(tree):
            if isinstance(function, _FUNCTIONS) and function.name != "__init__":
                self._changed |= {
                    node.attr
                    for node in walk(function)
                    if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load)
                }

    def decides(self, test: ast.expr) -> bool:
        """Whether a condition depends on nothing else."""
        every = walk(test)
        names = [node for node in every if isinstance(node, ast.Name)]
        attributes = [node for node in every if isinstance(node, ast.Attribute)]
        others = (ast.Call, ast.Subscript)
        return (
            not any(isinstance(node, others) for node in every)
            and all(name.id == "self" or name.id.isupper() for name in names)
            and all(attribute.attr.isupper() or attribute.attr not in self._changed for attribute in attributes)
        )


class _Suites:
    """Walks through the suites of one function.

    Attributes:
        mentions: the names that occur where play may come.
    """

    def __init__(self, fixed: _Fixed, numbers: Iterator[int], function: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        self._fixed = fixed
        self._numbers = numbers
        self._function = function
        self.mentions: set[str] = set()

    def marked(self) -> Iterator[Statement]:
        yield from self._suite(self._function.body, (), beside=False)

    def _suite(self, body: list[ast.stmt], tests: tuple[ast.expr, ...], beside: bool) -> Iterator[Statement]:
        """The statements of a suite that need a mark: the first one, the first one after another suite, and each one
        that matters.

        Args:
            body: the suite.
            tests: the conditions that lead to it.
            beside: whether play need not come there.
        """
        number = next(self._numbers)
        beside = beside or isinstance(body[-1], ast.Raise)
        beside = beside or (isinstance(body[-1], ast.Return) and any(map(_is_over, tests)))
        first = True
        for node in body:
            if not beside:
                self.mentions.update(*map(_mentions, _own(node)))
            if isinstance(node, _COMPOUND):
                first = True
                yield from self._inside(node, tests, beside)
            elif not _is_declaration(node):
                effects = frozenset[str]() if beside else self._effects(node)
                if (first or effects) and node.lineno > 1:
                    yield Statement(node.lineno, node.end_lineno or node.lineno, node.col_offset, number, effects)
                first = False

    def _inside(self, node: ast.stmt, tests: tuple[ast.expr, ...], beside: bool) -> Iterator[Statement]:
        if isinstance(node, (ast.ClassDef, *_FUNCTIONS)):
            # A function inside another one is walked through by itself.
            return
        if isinstance(node, ast.If | ast.While):
            tests = (*tests, node.test)
            beside = beside or self._is_beside(node.test)
        for name in ("body", "orelse", "finalbody"):
            if body := getattr(node, name, None):
                yield from self._suite(body, tests, beside)
        for handler in getattr(node, "handlers", ()):
            yield from self._suite(handler.body, tests, beside=True)
        for case in getattr(node, "cases", ()):
            yield from self._suite(case.body, tests, beside)

    def _is_beside(self, test: ast.expr) -> bool:
        constants = {node.value for node in walk(test) if isinstance(node, ast.Constant)}
        words = " ".join([*_mentions(test), *(value for value in constants if isinstance(value, str))])
        return bool(_BESIDE.search(words)) or _is_time(test) or self._fixed.decides(test)

    def _effects(self, node: ast.stmt) -> frozenset[str]:
        if isinstance(node, ast.Return):
            return _returned(node.value) if self._function.name == "step" else frozenset()
        if not isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign) or node.value is None:
            return frozenset()
        if isinstance(node.value, ast.Constant) and not node.value.value:
            return frozenset()
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        effects = {_EFFECTS[word] for target in targets for word in _words(target) if word in _EFFECTS}
        return frozenset(effects - {"pay"} if _is_penalty(node) else effects)


def _is_declaration(node: ast.stmt) -> bool:
    """Whether nothing may stand before a statement, or nothing runs there."""
    return isinstance(node, ast.Global | ast.Nonlocal) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    )


def _returned(value: ast.expr | None) -> frozenset[str]:
    """The effects of a result of ``step()`` that is written out."""
    if not isinstance(value, ast.Tuple) or len(value.elts) != 5:
        return frozenset()
    _, reward, terminated, _, _ = value.elts
    ends = isinstance(terminated, ast.Constant) and terminated.value is True
    pays = isinstance(reward, ast.Constant) and bool(reward.value)
    return frozenset([*["end"] * ends, *["pay"] * pays])


def _is_penalty(node: ast.Assign | ast.AugAssign | ast.AnnAssign) -> bool:
    """Whether an assignment takes something away."""
    taken = isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Sub)
    return taken or (isinstance(node.value, ast.UnaryOp) and isinstance(node.value.op, ast.USub))


def _words(target: ast.expr) -> Iterator[str]:
    """The last words of the names that an assignment sets."""
    if isinstance(target, ast.Tuple | ast.List):
        for each in target.elts:
            yield from _words(each)
    elif isinstance(target, ast.Subscript):
        if isinstance(target.slice, ast.Constant) and isinstance(target.slice.value, str):
            yield _last_word(target.slice.value)
    elif isinstance(target, ast.Attribute | ast.Name):
        yield _last_word(target.attr if isinstance(target, ast.Attribute) else target.id)


def _last_word(name: str) -> str:
    words = re.findall("[a-z]+", name.lower())
    return words[-1] if words else ""


def _is_time(test: ast.expr) -> bool:
    """Whether a condition compares a count of time: some episodes do not last so long."""
    compared = [node for node in walk(test) if isinstance(node, ast.Compare)]
    sides = [side for node in compared for side in (node.left, *node.comparators)]
    return any(_last_word(word) in _TIME for side in sides for word in _mentions(side))


def _is_over(test: ast.expr) -> bool:
    """Whether a condition is that the episode has ended, after which no step is needed."""
    return any(_EFFECTS.get(_last_word(word)) == "end" for word in _mentions(test))
