"""The lines of a report on a notebook, as the notebook shows them: counted within their cell."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Mapping
from typing import Any

import msgspec

from envcraft.model.verdict import CheckReport, Finding, Ignored

#: Lines that a message names; those of another file have its name before them.
_LINES = re.compile(r"(?<!\.py )\blines? (\d+(?:(?:, | and |-)\d+)*)")


class Cells:
    """The cells that a source is joined from.

    Args:
        path: the name that the source was judged under.
        cells: the first line of each cell, in order, by its name.
    """

    def __init__(self, path: str, cells: Mapping[str, int]) -> None:
        self._names, self._firsts = list(cells), list(cells.values())
        file = re.escape(path)
        self._places = re.compile(rf'(?:File ")?(?:[^\s"(]*/)?{file}(?:", line |:)(\d+)')

    def within(self, check: CheckReport) -> None:
        """Let the lines of a check's report count within their cells."""
        check.findings = [self._finding(finding) for finding in check.findings]
        check.known = [self._finding(finding) for finding in check.known]
        check.ignored = [
            Ignored(self._finding(one.finding), one.reason, self._at(one.line)[1]) for one in check.ignored
        ]
        check.reason = self._words(check.reason)

    def _finding(self, finding: Finding) -> Finding:
        cell, line = ("", None) if finding.line is None else self._at(finding.line)
        evidence: dict[str, Any] = {"cell": cell} if cell else {}
        for name, value in finding.evidence.items():
            evidence[name] = self._numbers(value, cell) if name == "lines" else self._places_in(value)
        return msgspec.structs.replace(
            finding, message=self._words(finding.message, cell), line=line, evidence=evidence
        )

    def _at(self, line: int) -> tuple[str, int]:
        """The cell of a line of the source, and the line within it."""
        index = max(bisect_right(self._firsts, line) - 1, 0)
        return self._names[index], line - self._firsts[index] + 1

    def _words(self, text: str, cell: str = "") -> str:
        """A text with its lines counted within their cells, which it names if they are not `cell`."""

        def counted(found: re.Match[str]) -> str:
            numbers = [int(number) for number in re.findall(r"\d+", found[1])]
            if len(names := {self._at(number)[0] for number in numbers}) > 1:
                return " and ".join(self._place(number) for number in numbers)
            words = re.sub(r"\d+", lambda number: str(self._at(int(number[0]))[1]), found[0])
            return words if names == {cell} else f"{names.pop()}, {words}"

        # What the code raises may name lines of something else.
        said, raises, raised = text.partition(" raises ")
        return self._placed(_LINES.sub(counted, said)) + raises + self._placed(raised)

    def _place(self, line: int) -> str:
        return "{}, line {}".format(*self._at(line))

    def _placed(self, text: str) -> str:
        """A text in which each place in the source is that in its cell."""
        return self._places.sub(lambda found: self._place(int(found[1])), text)

    def _places_in(self, value: Any) -> Any:
        """Evidence with the same."""
        if isinstance(value, str):
            return self._placed(value)
        return [self._places_in(each) for each in value] if isinstance(value, list) else value

    def _numbers(self, value: Any, cell: str) -> Any:
        """Lines counted within a cell, and the places of those in other cells."""
        if isinstance(value, list):
            return [self._numbers(each, cell) for each in value]
        if not isinstance(value, int):
            return self._places_in(value)
        name, line = self._at(value)
        return line if name == cell else self._place(value)
