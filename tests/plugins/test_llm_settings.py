"""``[tool.envcraft.llm]``, and what options change of it."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from envcraft_llm.endpoint import ModelChoice, model_options, open_model
from envcraft_llm.endpoint.connection import shown_address

from envcraft.cli import cli
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


def resolved(*arguments: str) -> ModelChoice:
    """What a command with `model_options` is given."""
    found: list[ModelChoice] = []

    @click.command()
    @click.argument("file")
    @model_options
    def command(file: str, chosen: ModelChoice) -> None:
        assert file == "x"
        found.append(chosen)

    result = CliRunner().invoke(command, ["x", *arguments], standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return found[0]


def test_without_settings_the_models_are_those_of_gpt_oss() -> None:
    chosen = resolved()
    assert (chosen.small, chosen.large, chosen.effort, chosen.base_url) == ("gpt-oss-20b", "gpt-oss-120b", "", "")
    assert [chosen.of(stage) for stage in ("briefs", "viability")] == ["gpt-oss-20b"] * 2
    assert [chosen.of(stage) for stage in ("code", "repair", "privileged")] == ["gpt-oss-120b"] * 3


def test_settings_are_read_and_options_come_before_them(here: Path) -> None:
    (here / "pyproject.toml").write_text(SETTINGS)
    chosen = resolved(
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
    assert (chosen.base_url, chosen.small, chosen.large) == ("http://127.0.0.1:8000/v1", "s", "gpt-oss-120b")
    assert (chosen.effort, chosen.max_concurrency, chosen.max_tokens_total) == ("high", 8, 25)
    plain = resolved()
    assert (plain.small, plain.effort, plain.max_concurrency, plain.max_cost) == ("tiny", "low", 200, None)
    assert plain.of("privileged") == "player"
    assert plain.prices["gpt-oss-120b"].completion == 0.5


def test_a_model_that_is_named_alone_is_that_of_all_stages(here: Path) -> None:
    (here / "pyproject.toml").write_text(SETTINGS)
    chosen = resolved("--model", "qwen")
    assert {chosen.of(stage) for stage in ("briefs", "code", "privileged")} == {"qwen"}


def test_the_address_may_be_that_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_BASE_URL", "http://127.0.0.1:9/v1")
    assert resolved().base_url == "http://127.0.0.1:9/v1"
    assert resolved("--base-url", "http://127.0.0.1:8/v1").base_url == "http://127.0.0.1:8/v1"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("llm.bas-url = ''", "has no setting 'bas-url'; did you mean base-url?"),
        ("llm.api-key = 'sk-secret-1'", "'api-key': keys are never read from a file; put it into the environment"),
        ("llm.effort = 'max'", "Invalid enum value 'max' - at `effort`"),
        ("llm.retries = 'many'", "Expected `int`, got `str` - at `retries`"),
        ("llm.retries = -1", "retries is -1; it must be 0 or more"),
        ("llm.total-seconds = 0", "total-seconds is 0; it must be above 0"),
        ("llm.min-concurrency = 9\nllm.max-concurrency = 3", "concurrency from 9 to 3"),
        ("llm.base-url = 'localhost:8000'", "'localhost:8000' is no address such as"),
        ("llm.prices.m = { promt = 1 }", "unknown field `promt`"),
        ("llm.prices.m = { prompt = -1 }", "the prices of m must be 0 or more"),
        ("llm = 3", "must be a table"),
        ("llm.max-cost = 3", "there is none of gpt-oss-120b, gpt-oss-20b: give"),
    ],
)
def test_mistakes_in_settings_are_a_sentence(here: Path, text: str, words: str) -> None:
    (here / "pyproject.toml").write_text(f"[tool.envcraft]\n{text}\n")
    with pytest.raises(UsageError) as wrong:
        resolved()
    assert words in str(wrong.value)
    assert "sk-secret" not in str(wrong.value)


def test_other_commands_pass_these_settings_over(here: Path) -> None:
    (here / "pyproject.toml").write_text(SETTINGS)
    result = CliRunner().invoke(cli, ["validate", "missing.py"])
    assert result.exit_code == 2
    assert "llm" not in result.stderr
    assert "missing.py" in result.stderr


def test_no_endpoint_and_no_journal_for_batches_are_wrong_use(here: Path) -> None:
    with pytest.raises(UsageError, match="no endpoint is named: give --base-url"):
        open_model(resolved(), None)
    with pytest.raises(UsageError, match="batches need a journal"):
        open_model(resolved("--batch", "--base-url", "http://127.0.0.1:9/v1"), None)
    assert not list(here.iterdir())


@pytest.mark.parametrize(
    ("address", "key", "words"),
    [
        (
            "http://me:secret@127.0.0.1:9/v1?",
            "k",
            r"http://127\.0\.0\.1:9/v1 has a name or a password.*OPENAI_API_KEY$",
        ),
        ("http://127.0.0.1:9/v1", "sk-secret\u2019", "^OPENAI_API_KEY has a letter that no key has.*copy the key anew"),
        ("http://127.0.0.1:9/v1", "sk-\nsecret", "^OPENAI_API_KEY has a letter that no key has"),
    ],
)
def test_what_no_request_could_be_sent_with_is_wrong_use(
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
def test_an_address_is_shown_without_what_is_secret_in_it(address: str, shown: str) -> None:
    assert shown_address(address) == shown
