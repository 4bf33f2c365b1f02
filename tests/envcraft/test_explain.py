"""``envcraft explain CODE`` prints the rule's guide."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest
from envcraft_checks.source import Source

from envcraft.judging import guide


def test_the_guide_is_printed_in_order(invoke: Any) -> None:
    result = invoke("explain", "ec203")
    assert result.exit_code == 0
    order = [
        "EC203 hash-seed",
        "Why is this bad?",
        "Two workers with the same seed",
        "class Corridor",
        "Usual fix",
        "How it is detected",
        "What it misses",
        "envcraft validate EC203.py --contract gymnasium",
    ]
    places = [result.stdout.index(words) for words in order]
    assert places == sorted(places)


def test_the_code_is_printed_alone(invoke: Any) -> None:
    result = invoke("explain", "EC203", "--example")
    assert result.exit_code == 0
    assert result.stdout.startswith("# contract: gymnasium\n")
    ast.parse(result.stdout)


@pytest.mark.parametrize("name", ["hash-seed", "Hash-Seed"])
def test_a_rule_has_a_name_beside_its_code(name: str, invoke: Any) -> None:
    assert invoke("explain", name).stdout == invoke("explain", "EC203").stdout
    assert "did you mean hash-seed?" in invoke("explain", "hash-sed").stderr


def test_a_check_has_no_example(invoke: Any) -> None:
    result = invoke("explain", "speed", "--example")
    words = "speed is a check, and only a rule has an example; name one of EC908, EC909"
    assert (result.exit_code, result.stderr) == (2, f"Error: {words}\n")


@pytest.mark.parametrize(("code", "option"), [("EC851", "--checks learnability"), ("EC804", "--policy policy.py")])
def test_the_command_names_what_the_rule_needs(invoke: Any, code: str, option: str) -> None:
    assert option in invoke("explain", code).stdout


def test_settings_are_those_of_the_first_lines() -> None:
    example = guide.Example("# contract: gymnasium\n# budget: standard\nimport a\n# contract: arcade\n")
    assert example.settings == {"contract": "gymnasium", "budget": "standard"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("## Example\n```python\npass\n```\n", "must have the sections"),
        ("## Why is this bad?\nA\n## Example\nnone\n## How it is detected\nB\n## What it misses\nC\n", "no block"),
    ],
)
def test_incomplete_guide_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, words: str) -> None:
    monkeypatch.setattr(guide, "guide_file", lambda check, code: tmp_path / f"{code}.md")
    (tmp_path / "EC001.md").write_text(text)
    assert guide.guide_of(Source(), "EC002") is None
    with pytest.raises(ValueError, match=words):
        guide.guide_of(Source(), "EC001")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("EC60", "EC60 is the beginning of 2 codes; name one of EC601, EC602"),
        ("", "there is no rule or check ''; there are"),
        ("ec0", "codes; name one of EC001, EC002, EC003, …"),
    ],
)
def test_the_beginning_of_codes_lists_them(invoke: Any, name: str, words: str) -> None:
    result = invoke("explain", name)
    assert result.exit_code == 2
    assert words in result.stderr


@pytest.mark.parametrize("code", ["EC203", "EC803"])
def test_code_of_a_narrow_page_can_be_copied(invoke: Any, monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    example = invoke("explain", code, "--example").stdout.strip()
    assert max(map(len, example.splitlines())) > 60
    assert example in invoke("explain", code).stdout
