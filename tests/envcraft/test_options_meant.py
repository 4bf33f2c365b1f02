"""An option that a command does not have: the error names the option that does it."""

from __future__ import annotations

import pytest

from tests.envcraft.conftest import Invoke


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("validate", "--json"), "--format json"),
        (("audit", "--sarif"), "--format sarif"),
        (("validate", "--html"), "--format html"),
        (("validate", "--docker"), "--sandbox docker"),
        (("audit", "--gymnasium"), "--contract gymnasium"),
        (("validate", "--quick"), "--budget quick"),
        (("validate", "--determinism"), "--checks determinism"),
        (("generate", "--tetris"), "--family tetris"),
        (("validate", "-o", "out.json"), "--output"),
        (("audit", "-o", "out.json"), "--only-failed or --output"),
        (("validate", "-c", "arcade"), "--contract, --checks or --class"),
        (("validate", "--out", "out.json"), "--output"),
        (("validate", "--junitxml", "out.xml"), "--report junit:FILE"),
        (("audit", "-j", "4"), "--workers"),
        (("validate", "--timeout=5"), "--time-limit"),
        (("validate", "--fail-on", "warning"), "--strict"),
    ],
)
def test_the_error_names_the_option_that_does_it(arguments: tuple[str, ...], meant: str, invoke: Invoke) -> None:
    result = invoke(*arguments)
    name = arguments[1].partition("=")[0]
    assert result.exit_code == 2
    assert result.stderr.endswith(f"Error: No such option '{name}'. Did you mean {meant}?\n")


def test_otherwise_click_suggests_a_similar_name(invoke: Invoke) -> None:
    result = invoke("validate", "--strickt")
    assert result.exit_code == 2
    assert "Did you mean one of: '--contract', '--strict'?" in result.stderr
