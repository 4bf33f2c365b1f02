"""Read untrusted sources as tokens and syntax trees, without running them. A failure gives None."""

from __future__ import annotations

import ast
import io
import tokenize
import warnings
from functools import lru_cache

from envcraft.model.target import parse

#: Larger sources are not read: an environment has a few thousand bytes, and each token takes microseconds.
MAX_BYTES = 512 * 1024
#: Markers for the end of a statement, an indent and a dedent. No token of a source equals them.
END, IN, OUT = "\n", "\x01", "\x02"

_UNREADABLE = (SyntaxError, ValueError, RecursionError, MemoryError, tokenize.TokenError)


@lru_cache(1)
def read_tokens(source: bytes) -> tuple[str, ...] | None:
    """The tokens of a source, with :data:`END`, :data:`IN` and :data:`OUT`; None if it cannot be tokenised.

    Comments, blank lines, spaces, breaks within a statement, and statements that are nothing but a string (docstrings)
    are left out. The last result is cached, since two layers use it.
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
    """The syntax tree of a source; None if it does not parse."""
    text = _text(source)
    if text is None:
        return None
    try:
        with warnings.catch_warnings():
            # Invalid escape sequences in strings warn.
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
