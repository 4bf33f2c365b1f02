"""The lines that are taken from a stack, which untrusted code may have written itself."""

from __future__ import annotations

import faulthandler
import tempfile
from typing import Any

import pytest
from envcraft_sandbox.stack import Stack

TARGET: Any = {"kind": "source", "filename": "grid \u00e9.py", "source": "a\nb\nc\n"}
FRAME = 'Stack (most recent call first):\n  File "{name}", line {line} in step\n'


def written(name: str) -> bytes:
    """A stack that Python writes in line 2 of a file of this name."""
    with tempfile.TemporaryFile() as stream:
        exec(compile("dump\nwrite()", name, "exec"), {"dump": 0, "write": lambda: dump(stream)})
        stream.seek(0)
        return stream.read()


def dump(stream: Any) -> None:
    faulthandler.dump_traceback(stream, all_threads=False)


def test_the_lines_of_the_file_are_read_from_a_stack() -> None:
    stack = Stack(TARGET)
    assert stack.take(b"printed\n" + written("grid \u00e9.py")) == b"printed\n"
    assert stack.lines == (2,)


@pytest.mark.parametrize(
    "text",
    [
        FRAME.format(name="other.py", line=1),
        FRAME.format(name="grid \\xe9.py", line=4),
        FRAME.format(name="grid \\xe9.py", line=0),
        FRAME.format(name="grid \\xe9.py", line="9" * 5000),
        FRAME.format(name="grid \\xe9.py", line="-1"),
        f"{FRAME.format(name='other.py', line=1)}printed\n{FRAME.format(name='grid xe9.py', line=1)}",
        "Stack (most recent call first):",
        "",
    ],
)
def test_a_line_that_the_file_does_not_have_is_left_out(text: str) -> None:
    stack = Stack(TARGET)
    stack.take(text.encode())
    assert stack.lines == ()


def test_the_lines_of_an_installed_target_are_unknown() -> None:
    stack = Stack({"kind": "id", "id": "CartPole-v1"})
    stack.take(written("grid \u00e9.py"))
    assert stack.lines == ()
