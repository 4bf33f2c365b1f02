"""Defects of state that outlives its episode or its instance."""

from __future__ import annotations

import ast

from benchmarks.mutation.operator import Places, operator
from benchmarks.mutation.operators.parts import first
from benchmarks.mutation.source import Source, nodes

_KEPT = ("EC20", "EC21", "EC05", "EC91")


def _plain(game: Source) -> list[tuple[str, ast.Assign]]:
    """The fields that ``reset`` sets to a constant, each with its assignment."""
    found = []
    for statement in game.methods["reset"].body:
        if isinstance(statement, ast.Assign) and isinstance(statement.value, ast.Constant | ast.List):
            found += [(game.of(target), statement) for target in statement.targets if isinstance(target, ast.Attribute)]
    return found


def _changed(game: Source, field: str) -> bool:
    """Whether play changes a field."""
    for name, method in game.methods.items():
        if name not in {"__init__", "reset"}:
            for node in nodes(method, ast.Attribute):
                used = game.parents[node]
                stored = isinstance(node.ctx, ast.Store) or isinstance(used, ast.AugAssign)
                mutated = isinstance(used, ast.Attribute) and used.attr in {"append", "add", "insert", "extend", "pop"}
                if game.of(node) == field and (stored or mutated):
                    return True
    return False


@operator(*_KEPT, "EC50", "EC10", "EC70", "EC30", "EC40", "EC80")
def reset_dropped(game: Source) -> Places:
    """Reset a field in the first episode only."""
    for field, statement in _plain(game):
        if _changed(game, field):
            name, value = field.removeprefix("self."), game.of(statement.value)
            others = [game.of(target) for target in statement.targets if game.of(target) != field]
            kept = [f"{' = '.join([*others, value])}"] if others else []
            first_time = f'if not hasattr(self, "{name}"):\n{" " * statement.col_offset}    {field} = {value}'
            yield [game.replace(statement, f"\n{' ' * statement.col_offset}".join([*kept, first_time]))]


@operator(*_KEPT)
def class_attribute(game: Source) -> Places:
    """Keep a field in the class, where all instances share it."""
    for field, _ in _plain(game):
        if field == game.counter:
            continue
        shared = field.replace("self.", "type(self).")
        used = [node for node in nodes(game.env, ast.Attribute) if game.of(node) == field]
        if _changed(game, field):
            yield [game.replace(node, shared) for node in used]


@operator(*_KEPT, "EC107", "EC104", "EC30", "EC50")
def default_argument(game: Source) -> Places:
    """Start each episode with the mutable default argument of a function."""
    for field, statement in _plain(game):
        if game.of(statement.value) == "[]" and _changed(game, field) and len(statement.targets) == 1:
            made = game.method("def _fresh(self, items=[]):", "    return items")
            yield [game.replace(statement.value, "self._fresh()"), made]


@operator(*_KEPT)
def late_leak(game: Source) -> Places:
    """Draw one more random number once twenty episodes have been played."""
    if game.seeding is not None and game.draws:
        yield [
            game.before(game.env.body[0], "records = []")
            if not isinstance(game.env.body[0], ast.Expr)
            else game.after(game.env.body[0], "records = []"),
            game.after(
                game.seeding,
                "self.records.append(len(self.records))",
                "if len(self.records) > 20:",
                "    self.np_random.random()",
            ),
        ]


@operator(*_KEPT)
def leak_after_win(game: Source) -> Places:
    """Draw one more random number in the episodes after a success."""
    if game.seeding is not None and game.draws and game.success and len(game.results) == 1:
        yield [
            game.after(game.seeding, 'if getattr(self, "champion", False):', "    self.np_random.random()"),
            game.before(game.results[0][0], f"if {game.success}:", "    self.champion = True"),
        ]


@operator(*_KEPT, "EC50")
def step_count_shared(game: Source) -> Places:
    """Count the steps of all instances together."""
    if game.counter is not None and game.counting is not None:
        shared = game.counter.replace("self.", "type(self).")
        used = [node for node in nodes(game.env, ast.Attribute) if game.of(node) == game.counter]
        yield [game.replace(node, shared) for node in used]


@operator(*_KEPT, "EC063")
def render_counts(game: Source) -> Places:
    """Let `render` advance the step counter."""
    if game.counter is not None and "render" in game.methods:
        yield [game.before(first(game, "render"), f"{game.counter} += 1")]


@operator(*_KEPT)
def levels_get_harder(game: Source) -> Places:
    """Take the limit of steps from the number of episodes that were played."""
    if game.seeding is not None:
        for limit in game.limits[:1]:
            text = game.of(limit)
            operation = " >= " if " >= " in text else " > "
            counter, bound = text.split(operation)
            yield [
                game.after(game.seeding, 'self.level = getattr(self, "level", -1) + 1'),
                game.replace(limit, f"{counter}{operation}max({bound} - 10 * self.level, 20)"),
            ]


@operator(*_KEPT)
def old_level_kept(game: Source) -> Places:
    """Remember drawn values from one episode to the next."""
    for method, call in game.draws:
        if method == "integers" and game.caller(call) == "reset" and isinstance(game.parents[call], ast.Call):
            kept = f'self.__dict__.setdefault("kept_{call.lineno}", {game.of(call)})'
            yield [game.replace(call, kept)]
