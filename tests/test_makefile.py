"""The Makefile passes to its functions what it means to."""

from __future__ import annotations

import re
from pathlib import Path

MAKEFILE = Path(__file__).resolve().parent.parent / "Makefile"


def test_no_argument_of_a_call_has_a_comma() -> None:
    # Make would split it there, and drop what follows.
    given = re.findall(r"\$\(call INSTALL,(.*)\)", MAKEFILE.read_text())
    assert given
    assert [argument for argument in given if "," in argument] == []
