"""Marks in a source: each records that the statement behind it was reached.

A mark is one more statement on the line of the marked one: a store into an array of bytes, a constant of the code. So
lines keep their numbers, and no name, no attribute and no object that the code works with changes. What the array says
is a claim of untrusted code, like everything else from this process.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from types import CodeType
from typing import Any

#: The digit of a mark that was reached.
_REACHED = ord("1")
_LINE = re.compile(rb"\r\n|\r|\n")

# Bound before any untrusted module can replace them.
_compile = compile


class Reached(bytearray):
    """One digit for each mark: 0, or 1 once it was reached. Code that has it as a constant can still be hashed."""

    __slots__ = ()
    __hash__ = object.__hash__  # type: ignore[assignment]

    def forget(self) -> None:
        """Start again with no mark reached."""
        self[:] = b"0" * len(self)


class Marked:
    """A source that is compiled with marks, or without any if a place is not that of a statement.

    Args:
        source: the text.
        filename: its name in tracebacks.
        places: line and column, in bytes of UTF-8, of the statements that are marked.

    Attributes:
        code: the code of the module.
        reached: the digits of the marks; empty without marks.
    """

    def __init__(self, source: str, filename: str, places: Sequence[Sequence[int]]) -> None:
        self.reached = Reached(b"0" * len(places))
        # A constant that the source does not have.
        self._name = "mark " + hashlib.sha256(source.encode("utf-8", "surrogatepass")).hexdigest()[:16]
        self._by_line: dict[int, list[tuple[int, int]]] = {}
        for number, (line, column) in enumerate(places):
            self._by_line.setdefault(line, []).append((column, number))
        try:
            code = _compile(self._text(source), filename, "exec") if places else None
        except (SyntaxError, ValueError, IndexError):
            code = None
        if code is None:
            self._by_line, self.reached = {}, Reached()
            self.code: CodeType = _compile(source, filename, "exec")
        else:
            self.code = self._linked(code)

    def _mark(self, number: int) -> bytes:
        return f"{self._name!r}[{number}]={_REACHED};".encode()

    def _text(self, source: str) -> str:
        data = source.encode()
        starts = [0, *(match.end() for match in _LINE.finditer(data))]
        parts, done = [], 0
        for line in sorted(self._by_line):
            for column, number in sorted(self._by_line[line]):
                at = starts[line - 1] + column
                parts += [data[done:at], self._mark(number)]
                done = at
        return b"".join([*parts, data[done:]]).decode()

    def _linked(self, code: CodeType) -> CodeType:
        """The code with the array in place of its name."""
        constants = tuple(self._constant(value) for value in code.co_consts)
        changed = any(new is not old for new, old in zip(constants, code.co_consts, strict=True))
        return code.replace(co_consts=constants) if changed else code

    def _constant(self, value: Any) -> Any:
        if type(value) is CodeType:
            return self._linked(value)
        return self.reached if type(value) is str and value == self._name else value

    def column(self, line: int | None, column: int | None) -> int | None:
        """The column in the source of a column in the marked text, both in bytes."""
        if line is None or column is None:
            return column
        shift = 0
        for start, number in sorted(self._by_line.get(line, ())):
            length = len(self._mark(number))
            if column - shift >= start + length:
                shift += length
        return column - shift
