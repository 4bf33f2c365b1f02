"""Edits that several operators share."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from benchmarks.mutation.source import Edit, Source


def flagged(game: Source, field: str) -> Iterator[tuple[ast.stmt, list[Edit]]]:
    """Each event with the edits that set a field to True there and to False in ``reset``."""
    if game.seeding is not None:
        for event in game.events:
            yield event, [game.after(game.seeding, f"{field} = False"), game.after(event, f"{field} = True")]


def result(game: Source, position: int, text: str) -> list[Edit]:
    """Replace one of the five values in each ``return`` of ``step``; ``{}`` in `text` stands for the old value."""
    edits = []
    for _, values in game.results:
        edits.append(game.replace(values[position], text.format(game.of(values[position]))))
    return edits


def pictured(game: Source, text: str) -> list[Edit]:
    """Replace what the method of the picture returns; ``{}`` in `text` stands for the old value."""
    return [game.replace(value, text.format(game.of(value))) for value in game.pictured]


def first(game: Source, method: str) -> ast.stmt:
    """The first statement of a method below its docstring."""
    body = game.methods[method].body
    documented = isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant)
    return body[1] if documented and len(body) > 1 else body[0]


OBSERVATION, REWARD, TERMINATED, TRUNCATED, INFO = range(5)
