"""Comments in an author's own file that ignore findings: ``# envcraft: ignore[EC203] the order does not matter``.

A comment covers its line, or the next line of code if it is on a line of its own. On the first lines of a class, a
function or a statement it covers all of it. ``# envcraft: ignore-file[EC203] reason`` covers the file, and findings
without a line.
"""

from __future__ import annotations

import ast
import bisect
import io
import re
import tokenize
from collections.abc import Iterator

import msgspec

from envcraft.model.target import parse
from envcraft.model.verdict import Finding, Ignored

_START = re.compile(r"#\s*envcraft:\s*ignore\b")
_COMMENT = re.compile(r"#\s*envcraft:\s*ignore(?P<file>-file)?\[(?P<codes>[^\]]*)\][\s:-]*(?P<reason>.*)")
_DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
#: Comments beyond this number are not read.
_MOST = 10_000


class IgnoreComment(msgspec.Struct, frozen=True):
    """One comment.

    Attributes:
        line: where it is.
        codes: those that it ignores; none if it is malformed.
        reason: why; "" if it gives none.
        first: the first line that it covers; 0 if it covers the whole file.
        last: the last line that it covers.
    """

    line: int
    codes: tuple[str, ...]
    reason: str
    first: int = 0
    last: int = 0

    def covers(self, finding: Finding) -> bool:
        """Whether this comment ignores a finding."""
        return finding.code in self.codes and (not self.first or self.first <= (finding.line or 0) <= self.last)


class IgnoreComments:
    """The comments of one file, and which of their codes have ignored a finding."""

    def __init__(self, text: str) -> None:
        self.comments = list(_read(text))
        self._used: set[tuple[int, str]] = set()

    def take(self, finding: Finding) -> Ignored | None:
        """Return a finding as an ignored one if a comment covers it. The narrowest comment does."""
        covering = [comment for comment in self.comments if comment.covers(finding)]
        if not covering:
            return None
        chosen = min(covering, key=lambda comment: (not comment.first, comment.last - comment.first))
        self._used.add((chosen.line, finding.code))
        return Ignored(finding, chosen.reason, chosen.line)

    def unused(self) -> Iterator[tuple[IgnoreComment, str]]:
        """Yield each code of a comment that has ignored no finding."""
        for comment in self.comments:
            for code in comment.codes:
                if (comment.line, code) not in self._used:
                    yield comment, code


def _read(text: str) -> Iterator[IgnoreComment]:
    """Yield the comments of a source; none of one that is not valid Python."""
    if "envcraft:" not in text:
        return
    try:
        tree = parse(text)
        tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    except (SyntaxError, ValueError, RecursionError, MemoryError, tokenize.TokenError):
        return
    blank = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    code = sorted({line for token in tokens if token.type not in blank for line in (token.start[0], token.end[0])})
    spans = _spans(tree)
    found = [token for token in tokens if token.type == tokenize.COMMENT and _START.search(token.string)]
    for token in found[:_MOST]:
        line = token.start[0]
        match = _COMMENT.search(token.string)
        if match is None:
            yield IgnoreComment(line, (), "")
            continue
        codes = tuple(dict.fromkeys(part.strip().upper() for part in match["codes"].split(",") if part.strip()))
        reason = match["reason"].strip()
        if match["file"]:
            yield IgnoreComment(line, codes, reason)
            continue
        at = bisect.bisect_left(code, line)
        own = code[at] if at < len(code) else line
        first, last = spans.get(own, (own, own))
        yield IgnoreComment(line, codes, reason, first, last)


def _spans(tree: ast.AST) -> dict[int, tuple[int, int]]:
    """The first and the last line of what a comment on a line covers, where that is more than the line."""
    spans: dict[int, tuple[int, int]] = {}
    for node in ast.walk(tree):
        if isinstance(node, _DEFINITIONS):
            first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
            head = max(node.body[0].lineno - 1, node.lineno)
        elif isinstance(node, ast.stmt) and not (hasattr(node, "body") or hasattr(node, "cases")):
            first, head = node.lineno, node.end_lineno or node.lineno
        else:
            continue
        last = node.end_lineno or first
        for line in range(first, head + 1):
            # A definition is wider than a statement on the same line.
            spans[line] = min(first, spans.get(line, (first, 0))[0]), max(last, spans.get(line, (0, last))[1])
    return spans
