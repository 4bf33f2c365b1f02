"""Imports of libraries that a contract does not allow, or that are not installed."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterable
from pathlib import Path

import pytest

from envcraft.judging.facts import WELL_KNOWN
from tests.envcraft.conftest import ENVIRONMENT, Invoke


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("envcraft", "line 1 imports envcraft, which is not available where environments run; leave it out, or move"),
        (
            "pytest",
            "line 1 imports pytest, which is not available where environments run; move the class to a file that",
        ),
        ("msgspec", "line 1 imports msgspec, which the contract arcade does not allow; it allows numpy, gymnasium, "),
        ("nunpy", "line 1 imports nunpy, which is not a known library; did you mean numpy?"),
        ("gym", "line 1 imports gym, which is not a known library; did you mean gymnasium?"),
    ],
)
def test_an_import_that_is_not_allowed_has_a_next_step(name: str, words: str, invoke: Invoke, good: Path) -> None:
    good.write_text(f"import {name}\n{ENVIRONMENT}")
    result = invoke("validate", good, "--sandbox", "process", "--format", "concise")
    assert words in result.stdout


@pytest.mark.parametrize("known", [WELL_KNOWN, ("stable_baselines3", "wandb")], ids=["of games", "of training"])
def test_a_library_that_is_not_installed_is_no_defect(known: Iterable[str], invoke: Invoke, good: Path) -> None:
    lacking = next(name for name in sorted(known) if importlib.util.find_spec(name) is None)
    good.write_text(f"import {lacking}\n{ENVIRONMENT}")
    options = ("--sandbox", "process", "--format", "concise", "--checks", "source")
    result = invoke("validate", good, *options, "--contract", "gymnasium")
    assert result.exit_code == 3, result.output
    assert f"{lacking} is not installed where the worker runs; install " in result.output
    assert "EC002" not in result.output
    refused = invoke("validate", good, *options)
    assert refused.exit_code == 1
    assert f"imports {lacking}, which the contract arcade does not allow" in refused.stdout


def test_a_script_that_cannot_be_imported_is_said_to_have_no_class(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "train.py").write_text("import argparse\n\nargparse.ArgumentParser().error('--steps')")
    result = invoke("validate", tmp_path / "train.py", "--sandbox", "process", "--format", "concise")
    assert result.exit_code == 1, result.output
    assert "EC003" in result.stdout
    assert "the file defines no class that could be an environment" in result.stdout


def test_a_script_without_an_environment_needs_no_library(invoke: Invoke, tmp_path: Path) -> None:
    lacking = next(name for name in sorted(WELL_KNOWN) if importlib.util.find_spec(name) is None)
    (tmp_path / "train.py").write_text(f"import {lacking}\nimport zz_helpers\n\n{lacking}.run()\n")
    for contract in ("gymnasium", "arcade"):
        options = ("--sandbox", "process", "--format", "concise", "--contract", contract)
        result = invoke("validate", tmp_path / "train.py", *options)
        assert result.exit_code == 1, result.output
        assert "EC005 the file defines no concrete subclass of gymnasium.Env" in result.stdout
        assert "EC002" not in result.stdout


def test_a_library_that_nobody_knows_may_exist(invoke: Invoke, good: Path) -> None:
    good.write_text(f"import zz_helpers\n{ENVIRONMENT}")
    options = ("--sandbox", "process", "--format", "concise", "--checks", "source", "--contract", "gymnasium")
    result = invoke("validate", good, *options)
    assert "EC002" in result.stdout
    assert "which is neither installed nor known to EnvCraft; correct the name, or install" in result.stdout
