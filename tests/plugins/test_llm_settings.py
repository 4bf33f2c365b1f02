"""``[tool.envcraft.llm]``, and the options that override it."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from envcraft_llm.endpoint import ModelSettings, model_options, open_model
from envcraft_llm.endpoint.connection import redacted_address

from envcraft.cli.group import cli
from envcraft.errors import UsageError

SETTINGS = """
[tool.envcraft]
budget = "quick"

[tool.envcraft.llm]
base-url = "http://127.0.0.1:8000/v1"
small_model = "tiny"
effort = "low"
max-concurrency = 200

[tool.envcraft.llm.models]
privileged = "player"

[tool.envcraft.llm.prices."gpt-oss-120b"]
prompt = 0.1
completion = 0.5
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("OPENAI_BASE_URL", "OPENAI_API_KEY", "ENVCRAFT_LLM_KEY_ENV"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def resolved(*arguments: str) -> ModelSettings:
    """Return the settings that a command with `model_options` gets."""
    found: list[ModelSettings] = []

    @click.command()
    @click.argument("file")
    @model_options
    def command(file: str, model_settings: ModelSettings) -> None:
        assert file == "x"
        found.append(model_settings)

    result = CliRunner().invoke(command, ["x", *arguments], standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return found[0]


def test_default_models() -> None:
    settings = resolved()
    assert (settings.small, settings.large, settings.effort, settings.base_url) == (
        "gpt-oss-20b",
        "gpt-oss-120b",
        "",
        "",
    )
    assert [settings.model_for(stage) for stage in ("briefs", "viability")] == ["gpt-oss-20b"] * 2
    assert [settings.model_for(stage) for stage in ("code", "repair", "privileged")] == ["gpt-oss-120b"] * 3


def test_options_override_settings(here: Path) -> None:
    (here / "pyproject.toml").write_text(SETTINGS)
    settings = resolved(
        "--concurrency",
        "8",
        "--max-tokens-total",
        "25",
        "--effort",
        "high",
        "--model",
        "gpt-oss-120b",
        "--small-model",
        "s",
    )
    assert (settings.base_url, settings.small, settings.large) == ("http://127.0.0.1:8000/v1", "s", "gpt-oss-120b")
    assert (settings.effort, settings.max_concurrency, settings.max_tokens_total) == ("high", 8, 25)
    plain = resolved()
    assert (plain.small, plain.effort, plain.max_concurrency, plain.max_cost) == ("tiny", "low", 200, None)
    assert plain.model_for("privileged") == "player"
    assert plain.prices["gpt-oss-120b"].completion == 0.5


def test_model_alone_applies_to_all_stages(here: Path) -> None:
    (here / "pyproject.toml").write_text(SETTINGS)
    settings = resolved("--model", "qwen")
    assert {settings.model_for(stage) for stage in ("briefs", "code", "privileged")} == {"qwen"}


def test_the_address_can_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", "http://127.0.0.1:9/v1")
    assert resolved().base_url == "http://127.0.0.1:9/v1"
    assert resolved("--base-url", "http://127.0.0.1:8/v1").base_url == "http://127.0.0.1:8/v1"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("llm.bas-url = ''", "has no setting 'bas-url'; did you mean base-url?"),
        ("llm.api-key = 'sk-secret-1'", "'api-key': a key is never read from a file; put it into the environment"),
        ("llm.effort = 'max'", "Invalid enum value 'max' - at `effort`"),
        ("llm.retries = 'many'", "Expected `int`, got `str` - at `retries`"),
        ("llm.retries = -1", "retries is -1; it must be 0 or more"),
        ("llm.total-seconds = 0", "total-seconds is 0; it must be above 0"),
        ("llm.min-concurrency = 9\nllm.max-concurrency = 3", "concurrency from 9 to 3"),
        ("llm.base-url = 'localhost:8000'", "'localhost:8000' is not an address such as"),
        ("llm.prices.m = { promt = 1 }", "unknown field `promt`"),
        ("llm.prices.m = { prompt = -1 }", "the prices of m, per million tokens, must be 0 or more"),
        ("llm = 3", "must be a table"),
        ("llm.max-cost = 3", "max-cost needs prices, and gpt-oss-120b, gpt-oss-20b has none: set"),
    ],
)
def test_invalid_settings_are_usage_errors(here: Path, text: str, words: str) -> None:
    (here / "pyproject.toml").write_text(f"[tool.envcraft]\n{text}\n")
    with pytest.raises(UsageError) as wrong:
        resolved()
    assert words in str(wrong.value)
    assert "sk-secret" not in str(wrong.value)


def test_other_commands_ignore_these_settings(here: Path) -> None:
    (here / "pyproject.toml").write_text(SETTINGS)
    result = CliRunner().invoke(cli, ["validate", "missing.py"])
    assert result.exit_code == 2
    assert "llm" not in result.stderr
    assert "missing.py" in result.stderr


def test_a_missing_endpoint_or_journal_is_a_usage_error(here: Path) -> None:
    with pytest.raises(UsageError, match="no endpoint is configured: give --base-url"):
        open_model(resolved(), None)
    with pytest.raises(UsageError, match="--batch needs a journal"):
        open_model(resolved("--batch", "--base-url", "http://127.0.0.1:9/v1"), None)
    assert not list(here.iterdir())


@pytest.mark.parametrize(
    ("address", "key", "words"),
    [
        (
            "http://me:secret@127.0.0.1:9/v1?",
            "k",
            r"http://127\.0\.0\.1:9/v1 has credentials before the host.*OPENAI_API_KEY$",
        ),
        (
            "http://127.0.0.1:9/v1",
            "sk-secret\u2019",
            "^OPENAI_API_KEY has a character that no key has.*copy the key again",
        ),
        ("http://127.0.0.1:9/v1", "sk-\nsecret", "^OPENAI_API_KEY has a character that no key has"),
    ],
)
def test_unusable_addresses_and_keys_are_usage_errors(
    here: Path, monkeypatch: pytest.MonkeyPatch, address: str, key: str, words: str
) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(UsageError, match=words) as wrong:
        open_model(resolved("--base-url", address), here / "corpus")
    assert "secret" not in str(wrong.value)
    assert not list(here.iterdir())


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("http://127.0.0.1:8000/v1", "http://127.0.0.1:8000/v1"),
        ("https://me:sec@ret@host/v1", "https://host/v1"),
        ("https://host/v1?key=secret", "https://host/v1"),
        ("https://[secret", "the address of --base-url"),
    ],
)
def test_addresses_are_redacted(address: str, shown: str) -> None:
    assert redacted_address(address) == shown
