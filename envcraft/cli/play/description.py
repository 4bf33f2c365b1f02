"""What a game is about, in its author's words: the docstring of its class or file."""

from __future__ import annotations

import ast
import re
import textwrap

from envcraft.model.target import parse
from envcraft.text import one_line

#: Columns of a line, and the most lines that leave room for the picture.
_WIDTH, _LINES = 76, 18
#: A line of a list or a table, which keeps its place.
_ITEM = re.compile(r"^\s*([-*|]|\d+[.)])\s", re.MULTILINE)
#: What a person must know to play comes first.
_FIRST = re.compile(r"\s*(goal|controls)\b", re.IGNORECASE)


def describe(source: bytes, env_class: str | None) -> list[str]:
    """Return the docstring of the class or of its file, the longer one, as lines of a screen.

    Args:
        source: the file that defines the class.
        env_class: the name of the class, if it is known.

    Returns:
        Lines of up to 76 characters, with an empty one between paragraphs, goal and controls first; none if there is
        no docstring.
    """
    try:
        module = parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []
    described: list[ast.Module | ast.ClassDef] = [module]
    described += [node for node in module.body if isinstance(node, ast.ClassDef) and node.name == env_class]
    text = max((ast.get_docstring(node) or "" for node in described), key=len)
    lines: list[str] = []
    for paragraph in sorted(text.split("\n\n"), key=lambda paragraph: not _FIRST.match(paragraph)):
        for part in paragraph.splitlines() if _ITEM.search(paragraph) else [paragraph]:
            lines += textwrap.wrap(one_line(part), _WIDTH)
        lines.append("")
    return lines[:-1] if len(lines) <= _LINES + 1 else [*lines[: _LINES - 1], "…"]
