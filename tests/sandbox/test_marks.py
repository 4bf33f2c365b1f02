"""Marks in a source change nothing but the array that they write to."""

from __future__ import annotations

import traceback
from typing import Any

import pytest
from envcraft_sandbox.worker.marks import Marked

from envcraft.judging.coverage import Coverage
from envcraft.model.target import Target
from evaluation.fixtures import examples, fixtures

SOURCE = '''"""A module."""
from __future__ import annotations

def share(whole, parts):
    """Divide."""
    if parts > 2: kind = "many"; part = whole / parts
    elif parts < 0:
        return None
    else:
        größe = "é"; kind, part = größe, whole / parts
    for each in range(int(part)):
        part += each
    return kind, \\
        part
'''


def marked(source: str) -> tuple[Marked, list[tuple[int, int]], dict[str, Any]]:
    places = Coverage(Target("game.py", source.encode())).places
    made = Marked(source, "game.py", places)
    names: dict[str, Any] = {}
    exec(made.code, names)
    return made, places, names


def test_each_mark_is_that_of_its_statement() -> None:
    made, places, names = marked(SOURCE)
    assert [line for line, _ in places] == [6, 8, 10, 12, 13]
    assert names["share"](12, 3) == ("many", 10)
    assert [line for (line, _), digit in zip(places, made.reached.decode(), strict=True) if digit == "1"] == [6, 12, 13]
    names["share"](0, 1)
    names["share"](0, -1)
    assert made.reached == b"11111"
    made.reached.forget()
    assert made.reached == b"00000"


def test_the_module_looks_the_same() -> None:
    plain: dict[str, Any] = {}
    exec(compile(SOURCE, "game.py", "exec"), plain)
    _, _, names = marked(SOURCE)
    assert set(names) == set(plain)
    assert names["share"].__doc__ == "Divide."
    assert names["share"].__code__.co_names == plain["share"].__code__.co_names
    assert names["share"].__code__.co_varnames == plain["share"].__code__.co_varnames
    assert names["share"].__code__.co_firstlineno == 4
    assert isinstance(hash(names["share"].__code__), int)


def test_columns_are_those_of_the_source() -> None:
    made, _, names = marked(SOURCE)
    with pytest.raises(ZeroDivisionError) as raised:
        names["share"](1, 0)
    frame = traceback.extract_tb(raised.value.__traceback__)[-1]
    assert frame.lineno == 10
    part = slice(made.column(10, frame.colno), made.column(10, frame.end_colno))
    assert SOURCE.encode().split(b"\n")[9][part] == b"whole / parts"


@pytest.mark.parametrize("places", [[(99, 0)], [(3, 0), (6, 15), (12, 9)], [(1, 2)]])
def test_without_places_that_fit_there_are_no_marks(places: list[tuple[int, int]]) -> None:
    made = Marked(SOURCE, "game.py", places)
    names: dict[str, Any] = {}
    exec(made.code, names)
    assert made.reached == b""
    assert names["share"](12, 3) == ("many", 10)


@pytest.mark.parametrize("newline", ["\r\n", "\r", "\n\x0c"])
def test_lines_end_as_for_the_compiler(newline: str) -> None:
    source = SOURCE.replace("\\\n        part", "part").replace("\n", newline)
    made, places, names = marked(source)
    assert names["share"](12, 3) == ("many", 10)
    assert made.reached.count(b"1") == 3
    assert len(places) == len(made.reached) == 5


@pytest.mark.parametrize("path", [each.path for each in (*examples(), *fixtures())], ids=lambda path: path.stem)
def test_every_environment_can_be_marked(path: Any) -> None:
    try:
        source = path.read_bytes().decode("utf-8-sig")
        plain = compile(source, path.name, "exec")
    except (SyntaxError, UnicodeDecodeError, ValueError):
        assert not Coverage(Target(str(path), path.read_bytes())).places
        return
    coverage = Coverage(Target(str(path), path.read_bytes()))
    made = Marked(source, path.name, coverage.places)
    assert len(made.reached) == len(coverage.places)
    assert _lines(plain) <= _lines(made.code)
    assert {line for line, _ in coverage.places} <= _lines(made.code)


def _lines(code: Any) -> set[int]:
    found = {line for _, _, line in code.co_lines() if line is not None}
    return found.union(*(_lines(each) for each in code.co_consts if isinstance(each, type(code))))
