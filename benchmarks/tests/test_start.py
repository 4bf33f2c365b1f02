"""Every benchmark that the Makefile names starts, and the Makefile names every benchmark."""

from __future__ import annotations

import importlib
import re

import pytest

from evaluation.fixtures import ROOT

MAKEFILE = set(re.findall(r"-m (benchmarks\.\w+)", (ROOT / "Makefile").read_text("utf-8")))
#: Programs that other benchmarks start, or that write a file of the documentation.
HELPERS = {
    "benchmarks.bare",
    "benchmarks.peers",
    "benchmarks.composer_picture",
    "benchmarks.family_picture",
    "benchmarks.real_world",
    "benchmarks.third_party",
}
#: Those without options.
PLAIN = {"benchmarks.explorer_pictures", "benchmarks.demo", "benchmarks.picture", "benchmarks.recording"}


@pytest.mark.parametrize("name", sorted(MAKEFILE - PLAIN))
def test_benchmark_starts(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(name).main(["--help"])
    assert ended.value.code == 0
    assert "usage:" in capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(PLAIN | HELPERS))
def test_program_is_importable(name: str) -> None:
    assert callable(importlib.import_module(name).__dict__["main" if name != "benchmarks.peers" else "complaints"])


def test_makefile_is_complete() -> None:
    programs = {
        f"benchmarks.{path.stem}"
        for path in (ROOT / "benchmarks").glob("*.py")
        if 'if __name__ == "__main__":' in path.read_text("utf-8")
    }
    assert programs - HELPERS == MAKEFILE
