"""The source of a game as mutation operators see it: where its parts are, and edits of its text.

The parts are located in the syntax tree and edited in the text, so a mutant keeps the author's layout and comments.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterable
from functools import cached_property
from typing import NamedTuple, TypeVar

_T = TypeVar("_T", bound=ast.AST)

#: Names by which authors call a won game, a lost one, and the flag for both.
_WON = {"won", "win", "success", "solved", "has_won", "victory"}
_LOST = {"lost", "lose", "dead", "crashed", "failed", "game_over", "caught_by_guard"}
_ENDED = {"terminated", "done", "term"}


class Edit(NamedTuple):
    """Replace the text between two offsets."""

    start: int
    end: int
    text: str


class Source:
    """One game. Raises LookupError where the text defines no class with ``reset`` and ``step``."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tree = ast.parse(text)
        self.parents = {child: node for node in ast.walk(self.tree) for child in ast.iter_child_nodes(node)}
        # Offsets in the syntax tree count bytes of a line.
        self._lines = list(itertools.accumulate((len(line.encode()) for line in text.splitlines(True)), initial=0))
        self._bytes = text.encode()
        found = [
            node
            for node in ast.walk(self.tree)
            if isinstance(node, ast.ClassDef) and {"reset", "step"} <= {method.name for method in _functions(node)}
        ]
        if not found:
            raise LookupError("no class with reset() and step()")
        self.env = found[-1]
        self.methods = {method.name: method for method in _functions(self.env)}

    # Text and edits

    def of(self, node: ast.AST) -> str:
        """The text of a node."""
        start, end = self._span(node)
        return self.text[start:end]

    def replace(self, node: ast.AST, text: str) -> Edit:
        return Edit(*self._span(node), text)

    def after(self, statement: ast.stmt, *lines: str) -> Edit:
        """Insert lines below a statement, with its indentation."""
        end = self._span(statement)[1]
        return Edit(end, end, "".join("\n" + (" " * statement.col_offset + line).rstrip() for line in lines))

    def before(self, statement: ast.stmt, *lines: str) -> Edit:
        """Insert lines above a statement, with its indentation."""
        decorators = getattr(statement, "decorator_list", [])
        start = self._span(decorators[0])[0] - 1 if decorators else self._span(statement)[0]
        return Edit(start, start, "".join(line + "\n" + " " * statement.col_offset for line in lines))

    def imported(self, module: str) -> list[Edit]:
        """Import a module, if the file does not."""
        imports = [node for node in self.tree.body if isinstance(node, ast.Import)]
        if any(alias.name == module and alias.asname is None for node in imports for alias in node.names):
            return []
        return [self.before(imports[0], f"import {module}")]

    def method(self, *lines: str) -> Edit:
        """Add a method to the environment."""
        return self.after(self.env.body[-1], "", *lines)

    def edited(self, edits: Iterable[Edit]) -> str:
        """Apply edits that do not overlap. Raises ValueError if they do."""
        ordered = sorted(edits, key=lambda edit: edit[:2])
        if any(one.end > two.start for one, two in itertools.pairwise(ordered)):
            raise ValueError("two edits overlap")
        text = self.text
        for edit in reversed(ordered):
            text = text[: edit.start] + edit.text + text[edit.end :]
        return text

    def _span(self, node: ast.AST) -> tuple[int, int]:
        where = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)  # type: ignore[attr-defined]
        start, end = (len(self._bytes[: self._lines[line - 1] + column].decode()) for line, column in where)
        return start, end

    # Parts that any game has

    @property
    def action(self) -> str:
        """The name of the action in ``step``."""
        return self.methods["step"].args.args[1].arg

    @cached_property
    def seeding(self) -> ast.stmt | None:
        """The statement ``super().reset(seed=seed)``."""
        for statement in self.methods["reset"].body:
            if isinstance(statement, ast.Expr) and self.of(statement).startswith("super().reset("):
                return statement
        return None

    @cached_property
    def draws(self) -> list[tuple[str, ast.Call]]:
        """Each call of a method of ``self.np_random`` with the method's name, in the order of the text."""
        calls = [node for node in ast.walk(self.env) if isinstance(node, ast.Call)]
        found = [
            (call.func.attr, call)
            for call in calls
            if isinstance(call.func, ast.Attribute) and self.of(call.func.value) == "self.np_random"
        ]
        return sorted(found, key=lambda pair: pair[1].lineno)

    def caller(self, node: ast.AST) -> str:
        """The name of the environment's method that a node stands in, "" for none."""
        while node in self.parents:
            if isinstance(node, ast.FunctionDef) and self.parents[node] is self.env:
                return node.name
            node = self.parents[node]
        return ""

    @cached_property
    def results(self) -> list[tuple[ast.Return, list[ast.expr]]]:
        """Each ``return`` of ``step`` that names the five values."""
        return [
            (node, node.value.elts)
            for node in nodes(self.methods["step"], ast.Return)
            if isinstance(node.value, ast.Tuple) and len(node.value.elts) == 5
        ]

    @cached_property
    def counter(self) -> str | None:
        """The field that counts the steps of an episode."""
        compared = {self.of(node.left) for node, _ in self._compared}
        for statement in self.methods["step"].body:
            if isinstance(statement, ast.AugAssign) and isinstance(statement.op, ast.Add):
                name = self.of(statement.target)
                if name.startswith("self.") and name in compared and self.of(statement.value) == "1":
                    return name
        return None

    @cached_property
    def _compared(self) -> list[tuple[ast.Compare, ast.expr]]:
        return [
            (node, node.comparators[0])
            for node in nodes(self.env, ast.Compare)
            if len(node.ops) == 1 and isinstance(node.ops[0], ast.GtE | ast.Gt | ast.Eq)
        ]

    @property
    def counting(self) -> ast.stmt | None:
        """The statement that counts a step."""
        for statement in self.methods["step"].body:
            if isinstance(statement, ast.AugAssign) and self.of(statement.target) == self.counter:
                return statement
        return None

    @property
    def limits(self) -> list[ast.Compare]:
        """Comparisons of the step counter with the limit, such as ``self.steps >= MAX_STEPS``."""
        return [
            node
            for node, limit in self._compared
            if self.of(node.left) == self.counter
            and not isinstance(node.ops[0], ast.Eq)
            and isinstance(limit, ast.Name | ast.Attribute | ast.Constant)
        ]

    @cached_property
    def picture(self) -> ast.FunctionDef | None:
        """The method whose result is the observation: where ``step`` gets it, past methods that only pass it on."""
        for _, values in self.results:
            method = self._method_of(values[0])
            while method is not None:
                last = method.body[-1]
                passed = self._method_of(last.value) if isinstance(last, ast.Return) and len(method.body) < 3 else None
                if passed is None:
                    return method
                method = passed
        return None

    def _method_of(self, value: ast.expr | None) -> ast.FunctionDef | None:
        """The method that an expression calls, by itself or through a local name."""
        if isinstance(value, ast.Name):
            for node in nodes(self.methods["step"], ast.Assign):
                if self.of(node.targets[0]) == value.id:
                    return self._method_of(node.value)
        if isinstance(value, ast.Call) and self.of(value.func).startswith("self."):
            return self.methods.get(self.of(value.func)[5:])
        return None

    @property
    def pictured(self) -> list[ast.expr]:
        """The values that the method of the picture returns."""
        returned = nodes(self.picture, ast.Return) if self.picture else []
        return [node.value for node in returned if node.value is not None]

    @cached_property
    def drawing(self) -> set[str]:
        """The names of the methods that take part in drawing."""
        found = {"render"} | ({self.picture.name} if self.picture else set())
        while True:
            calls = [call for name in found & set(self.methods) for call in nodes(self.methods[name], ast.Call)]
            reached = {self.of(call.func)[5:] for call in calls if self.of(call.func).startswith("self.")}
            if reached & set(self.methods) <= found:
                return found
            found |= reached & set(self.methods)

    @cached_property
    def events(self) -> list[ast.stmt]:
        """Statements that run when something happens: a field or the reward changes by a constant in a branch."""
        found: list[ast.stmt] = []
        for name, method in self.methods.items():
            if name in self.drawing | {"__init__", "reset"}:
                continue
            for node in nodes(method, ast.AugAssign):
                target = self.of(node.target)
                field = isinstance(node.target, ast.Attribute) and target != self.counter
                if (field or target == "reward") and self._branched(node) and isinstance(node.value, ast.Constant):
                    found.append(node)
        return found

    @property
    def scores(self) -> list[ast.AugAssign]:
        """Events that count something upwards in a field."""
        return [
            event
            for event in self.events
            if isinstance(event, ast.AugAssign)
            and isinstance(event.op, ast.Add)
            and isinstance(event.target, ast.Attribute)
            and self.of(event.value) == "1"
        ]

    def _branched(self, node: ast.stmt) -> bool:
        """Whether a statement stands in a branch, or in a method that is called in play and does only this."""
        parent = self.parents[node]
        alone = self.text.splitlines()[node.lineno - 1][: node.col_offset].strip() == ""
        if isinstance(parent, ast.For):
            parent = self.parents[parent]
        return alone and (isinstance(parent, ast.If) or (isinstance(parent, ast.FunctionDef) and parent.name != "step"))

    @cached_property
    def success(self) -> str | None:
        """The expression of success in ``info``, where it can be read in ``step``."""
        for node in nodes(self.env, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                if isinstance(key, ast.Constant) and key.value == "is_success" and self.of(value) != "False":
                    text = self.of(value)
                    if self.caller(node) == "step" or not names_in(value) - {
                        "self",
                        "len",
                        "bool",
                        "all",
                        "any",
                        "sum",
                    }:
                        return text
        return None

    # Endings

    @cached_property
    def wins(self) -> list[ast.expr]:
        """The values that are assigned to a name of the won game in play."""
        return self._assigned(_WON)

    @cached_property
    def losses(self) -> list[ast.expr]:
        """The values that are assigned to a name of the lost game, or of the end, in play."""
        return self._assigned(_LOST) or [value for value in self._assigned(_ENDED) if self.of(value) != "False"]

    def _assigned(self, names: set[str]) -> list[ast.expr]:
        found = []
        for name, method in self.methods.items():
            if name in {"__init__", "reset"}:
                continue
            for node in nodes(method, ast.Assign):
                if len(node.targets) == 1 and self.of(node.targets[0]).removeprefix("self.") in names:
                    found.append(node.value)
        return [value for value in found if self.of(value) != "False"]

    def ends_when(self, values: list[ast.expr], condition: str) -> list[Edit] | None:
        """Make one of the values (:attr:`wins`, :attr:`losses`) true under one more condition, in terms of ``step``."""
        for value in values:
            assignment = self.parents[value]
            assert isinstance(assignment, ast.Assign)
            if self.of(value) == "True" and self.of(assignment.targets[0]).startswith("self."):
                field = self.of(assignment.targets[0])
                return [self.before(self._deciding, f"if {condition}:", f"    {field} = True")]
            if self.of(value) != "True" and self.caller(value) == "step":
                return [self.replace(value, f"({self.of(value)}) or bool({condition})")]
        return None

    @property
    def _deciding(self) -> ast.stmt:
        """The statement of ``step`` that computes the flags."""
        for statement in self.methods["step"].body:
            if isinstance(statement, ast.Assign) and self.of(statement.targets[0]) in _ENDED | {"truncated"}:
                return statement
        return self.methods["step"].body[-1]

    # What the player controls

    @cached_property
    def controlled(self) -> set[str]:
        """Fields that play sets directly from the action."""
        fields: set[str] = set()
        tainted = {"step": {self.action}}
        for _ in range(4):
            for name, names in list(tainted.items()):
                self._spread(self.methods[name], names, fields, tainted)
        return fields - ({self.counter} if self.counter else set())

    def _spread(self, method: ast.FunctionDef, names: set[str], fields: set[str], tainted: dict[str, set[str]]) -> None:
        for node in ast.walk(method):
            if isinstance(node, ast.Assign | ast.AugAssign) and (
                names_in(node.value) & names or self._depends(node, names)
            ):
                for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                    for part in ast.walk(target):
                        if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                            names.add(part.id)
                        if isinstance(part, ast.Attribute) and self.of(part.value) == "self":
                            fields.add(self.of(part))
            if isinstance(node, ast.Call) and self.of(node.func).startswith("self."):
                called = self.methods.get(self.of(node.func)[5:])
                for at, value in enumerate(node.args):
                    if called is not None and names_in(value) & names and at + 1 < len(called.args.args):
                        tainted.setdefault(called.name, set()).add(called.args.args[at + 1].arg)

    def _depends(self, node: ast.AST, names: set[str]) -> bool:
        while not isinstance(node, ast.FunctionDef):
            child, node = node, self.parents[node]
            if isinstance(node, ast.If) and child in node.body and names_in(node.test) & names:
                return True
        return False


def _functions(node: ast.ClassDef) -> list[ast.FunctionDef]:
    return [part for part in node.body if isinstance(part, ast.FunctionDef)]


def nodes(node: ast.AST, kind: type[_T]) -> list[_T]:
    """The nodes of one kind, in the order of the text."""
    found = [part for part in ast.walk(node) if isinstance(part, kind)]
    return sorted(found, key=lambda part: (part.lineno, part.col_offset))  # type: ignore[attr-defined]


def names_in(node: ast.AST) -> set[str]:
    """The names that an expression or a statement mentions."""
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
