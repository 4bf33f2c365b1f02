"""What a finding blames on a file: neither a line of another file nor a warning of a library."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import envcraft_checks.source as source_check
import pytest
from envcraft_checks.api import Api
from envcraft_checks.source import Source

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Finding
from evaluation.fixtures import FIXTURES

GAME = (FIXTURES / "api" / "bad" / "render_missing.py").read_text()


def findings(source: str | bytes, *checks: Check) -> dict[str, Finding]:
    data = source.encode() if isinstance(source, str) else source
    *_, last = validate(Plan([Target("game.py", data)], ARCADE, driver_named("process"), checks, BUDGETS["quick"]))
    assert isinstance(last, Finished)
    return {finding.code: finding for check in last.report.reports[0].checks for finding in check.findings}


def test_inherited_method_has_the_line_of_the_class() -> None:
    lines = GAME.splitlines()
    found = findings(GAME, Source(), Api())
    assert found["EC112"].line == lines.index("class MopEnv(gym.Env):") + 1


@pytest.mark.parametrize(
    ("source", "line", "words"),
    [
        (b"import os\nfor x in range(3)\n    pass\n", 2, "expected ':'"),
        (b"import os\n\nx = '\xe9'\n", 3, "the byte 0xe9 is not UTF-8 text"),
    ],
)
def test_the_line_of_what_is_not_python_is_not_said_twice(source: bytes, line: int, words: str) -> None:
    [found] = findings(source, Source()).values()
    assert (found.code, found.line, found.message) == ("EC001", line, words)


@pytest.mark.parametrize(("module", "blamed"), [("library.fonts", False), ("envcraft_subject", True)])
def test_only_warnings_of_the_file_count_as_output(module: str, blamed: bool) -> None:
    warning = f"import warnings\nwarnings.warn_explicit('no fonts', UserWarning, 'x.py', 1, module={module!r})\n"
    assert ("EC009" in findings(GAME + warning, Source())) is blamed


_SLOW = "import time\ntime.sleep(1)\n"


@pytest.mark.parametrize(
    ("line", "slow"),
    [
        ("import time; time.sleep(0.4)", True),
        ("import time; end = time.process_time() + 0.4\nwhile time.process_time() < end: pass", True),
        ("import scipy.stats", False),
        ("from scipy import signal, optimize", False),
        ("__import__('scipy.stats')", False),
    ],
)
def test_only_the_time_of_the_file_s_own_code_counts(line: str, slow: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_check, "_SLOW_IMPORT", 0.2)
    found = findings(f"{GAME}\n\n{line}\n", Source())
    assert ("EC009" in found) is slow, found
    assert not slow or "s without the libraries that it imports" in found["EC009"].message


def test_the_time_of_a_helper_counts_and_not_that_of_its_libraries(tmp_path: Path) -> None:
    for file, text in [("own/helper.py", "import slow, time\ntime.sleep(0.1)\n"), ("lib/slow.py", _SLOW)]:
        (tmp_path / file).parent.mkdir()
        (tmp_path / file).write_text(text)
    own = str(tmp_path / "own")
    words = (
        f"import builtins, sys; sys.path += [{own!r}, {str(tmp_path / 'lib')!r}]; before = builtins.__import__\n"
        f"from envcraft_sandbox.worker.own_time import OwnTime\nwith OwnTime({own!r}) as own:\n    import helper\n"
        "assert builtins.__import__ is before\nprint(own.seconds)"
    )
    ran = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert 0.1 <= float(ran.stdout) < 0.9


_METHOD = "    def __init__(self, render_mode=None):\n"


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("", "print('hello')\n", "print('hello')"),
        ("", "for i in range(3):\n    print('hello' * i)\n", "print('hello' * i)"),
        ("", "def greet():\n    print(f'hello {3}')\n\n\ngreet()\n", "print(f'hello {3}')"),
        ("", "if len(sys.argv) > 9:\n    print('usage')\nprint('hello')\n", "print('hello')"),
        ("", "print('hello')\nif __name__ == '__main__':\n    print('hello')\n", "print('hello')"),
        ("class MopEnv(gym.Env):\n", "class MopEnv(gym.Env):\n    print('hello')\n", "print('hello')"),
        (_METHOD, f"{_METHOD}        print('hello')\n", "print('hello')"),
        ("", "print('hello')\nprint('hello')\n", None),
        ("", "if len(sys.argv) > 9:\n    print('usage')\nsys.stdout.write('hello')\n", None),
        ("", "rng = np.random.default_rng(3)\nnp.random.seed(0)\nnp.random.rand()\n", "np.random.seed(0)"),
        (
            "",
            "import random\nLEVEL = [random.random() for _ in range(3)]\n",
            "LEVEL = [random.random() for _ in range(3)]",
        ),
    ],
    ids=[
        "module",
        "loop",
        "called",
        "another",
        "main block",
        "class",
        "constructor",
        "twice",
        "no print",
        "seed",
        "draw",
    ],
)
def test_the_line_that_prints_or_seeds(old: str, new: str, named: str | None) -> None:
    text = "import sys\n" + (GAME.replace(old, new, 1) if old else GAME + new)
    found = findings(text, Source())["EC009"]
    assert (text.splitlines()[found.line - 1].strip() if found.line is not None else None) == named
    assert found.message.startswith("the constructor prints" if old == _METHOD else "loading the file ")


def test_what_the_constructor_prints_is_not_said_of_the_import() -> None:
    text = GAME.replace(_METHOD, f"{_METHOD}        print('hello')\n", 1) + "np.random.rand()\n"
    words = "loading the file changes the global random generators, and the constructor prints 'hello'"
    assert findings(text, Source())["EC009"].message == words
