"""Only the package of the store, and the journal of model answers, contain SQL."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: The journal of model answers is a database of its own.
ALLOWED = ("envcraft/corpus/store/", "plugins/envcraft_llm/endpoint/journal.py")
METHODS = {"execute", "executemany", "executescript", "db"}


def test_no_other_module_uses_the_database() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for folder in ("envcraft", "plugins")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if not str(path.relative_to(ROOT)).startswith(ALLOWED)
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Attribute) and node.attr in METHODS
    ]
    assert found == []
