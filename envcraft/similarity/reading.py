"""Sources as tokens and as trees, guarded: whatever a file holds, it is read or it is not, and never run."""

from __future__ import annotations

import ast
import io
import tokenize
import warnings
from functools import lru_cache

from envcraft.target import parse

#: Larger sources are not looked into: environments have a few thousand bytes, and a token takes microseconds.
MAX_BYTES = 512 * 1024
#: What stands for the end of a statement, a step in and a step out: no token of a source has these.
END, IN, OUT = "\n", "\x01", "\x02"

_UNREADABLE = (SyntaxError, ValueError, RecursionError, MemoryError, tokenize.TokenError)


@lru_cache(1)
def read_tokens(source: bytes) -> tuple[str, ...] | None:
    """The tokens of a source, with :data:`END`, :data:`IN` and :data:`OUT`; None where it is no text or cannot be cut.

    Comments, blank lines, spaces, breaks within a statement, and statements that are nothing but a string (docstrings)
    are left out. The last answer is remembered, since two layers ask for it.
    """
    text = _text(source)
    if text is None:
        return None
    found: list[str] = []
    statement: list[str] = []
    said = False
    try:
        for kind, word, *_ in tokenize.generate_tokens(io.StringIO(text).readline):
            if kind == tokenize.INDENT or kind == tokenize.DEDENT:
                found.append(IN if kind == tokenize.INDENT else OUT)
            elif kind == tokenize.NEWLINE or kind == tokenize.ENDMARKER:
                if said:
                    found += [*statement, END]
                statement, said = [], False
            elif kind == tokenize.ERRORTOKEN and not word.isspace():
                return None
            elif kind not in (tokenize.COMMENT, tokenize.NL, tokenize.ERRORTOKEN):
                said = said or kind != tokenize.STRING
                statement.append(word)
    except _UNREADABLE:
        return None
    return tuple(found)


def read_tree(source: bytes) -> ast.Module | None:
    """The tree of a source; None where it does not parse."""
    text = _text(source)
    if text is None:
        return None
    try:
        with warnings.catch_warnings():
            # Of strings with stray backslashes: nobody asked.
            warnings.simplefilter("ignore")
            return parse(text)
    except _UNREADABLE:
        return None


def _text(source: bytes) -> str | None:
    if len(source) > MAX_BYTES:
        return None
    try:
        return source.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        return None
