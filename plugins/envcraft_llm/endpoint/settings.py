"""``[tool.envcraft.llm]``: which models, where, at which prices and pace; and what the options of a command change."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from envcraft.cli import unknown
from envcraft.errors import UsageError
from envcraft.pyproject import settings

#: The stages that a small model is good enough for.
SMALL_STAGES = frozenset({"elaboration", "briefs", "viability"})
#: The models unless told.
SMALL, LARGE = "gpt-oss-20b", "gpt-oss-120b"
#: The environment variable that holds the key, and the one that may name another.
KEY, KEY_NAME = "OPENAI_API_KEY", "ENVCRAFT_LLM_KEY_ENV"

Effort = Literal["", "low", "medium", "high"]


class Price(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a million tokens cost, in any one currency."""

    prompt: float = 0.0
    completion: float = 0.0


class ModelChoice(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename="kebab"):
    """Settings and options together. Seconds are of one attempt, limits of one run.

    Attributes:
        base_url: where the endpoint is, with ``/v1``; empty where none is named.
        model: its name for the stages that write code, or empty for gpt-oss-120b.
        small_model: its name for elaboration, briefs and viability, or empty for `model` where that is given, else
            gpt-oss-20b.
        models: names for single stages.
        effort: of reasoning, or empty for the endpoint's own.
        prices: by the name of the model.
        min_concurrency, max_concurrency: how many requests may be under way, at least and at most.
        connect_seconds: until the connection stands.
        first_seconds: until the first piece of the answer, the endpoint's queue included.
        silence_seconds: between two pieces.
        total_seconds: until the end of the answer.
        retries: how often a request is sent again that was turned away or broke off.
        batch: whether requests are answered by the endpoint's Batch interface: cheaper, and within a day.
        max_cost: in the currency of the prices, or None for no limit.
        max_tokens_total: of prompts and answers, or None.
        max_seconds: from `open_model` until the last request is sent, or None.
    """

    base_url: str = ""
    model: str = ""
    small_model: str = ""
    models: dict[str, str] = {}
    effort: Effort = ""
    prices: dict[str, Price] = {}
    min_concurrency: int = 1
    max_concurrency: int = 64
    connect_seconds: float = 10.0
    first_seconds: float = 600.0
    silence_seconds: float = 120.0
    total_seconds: float = 3600.0
    retries: int = 8
    batch: bool = False
    max_cost: float | None = None
    max_tokens_total: int | None = None
    max_seconds: float | None = None

    @property
    def large(self) -> str:
        """The name of the model that writes code."""
        return self.model or LARGE

    @property
    def small(self) -> str:
        """The name of the model for elaboration, briefs and viability."""
        return self.small_model or self.model or SMALL

    def of(self, stage: str) -> str:
        """The name of the model for a stage."""
        return self.models.get(stage) or (self.small if stage in SMALL_STAGES else self.large)


def chosen(folder: Path, options: Mapping[str, Any]) -> ModelChoice:
    """``[tool.envcraft.llm]`` of the ``pyproject.toml`` in `folder` or the nearest one above, and what `options`, by
    the names of attributes, have instead; those that are None have nothing. Raises UsageError.
    """
    path, table = settings(folder)
    place = f"{path}: [tool.envcraft.llm]"
    found = table.get("llm", {})
    if not isinstance(found, dict):
        raise UsageError(f"{place} must be a table")
    known = {name: name for name in ModelChoice.__struct_encode_fields__}
    plain = {key.replace("_", "-"): value for key, value in found.items()}
    for key in plain:
        if key not in known:
            raise UsageError(f"{place} has no setting {_no_key(key) or unknown(key, known)}")
    try:
        choice = msgspec.convert(plain, ModelChoice)
    except msgspec.ValidationError as error:
        raise UsageError(f"{place}: {str(error).replace('`$.', '`')}") from None
    _check(choice, place)
    if not (options.get("base_url") or choice.base_url):
        # Where the client of OpenAI looks, too.
        choice = msgspec.structs.replace(choice, base_url=os.environ.get("OPENAI_BASE_URL", ""))
    changed = msgspec.structs.replace(choice, **{name: value for name, value in options.items() if value is not None})
    # A model that is named in the command goes for all stages that nothing else is named for there.
    if options.get("model") and not options.get("small_model"):
        changed = msgspec.structs.replace(changed, small_model="", models={})
    _check(changed, "the options")
    return changed


def key_from_environment() -> tuple[str, str]:
    """The name of the variable that holds the key, and the key, empty where it is not set."""
    name = os.environ.get(KEY_NAME) or KEY
    return name, os.environ.get(name, "").strip()


def _no_key(name: str) -> str:
    if "key" not in name:
        return ""
    return f"{name!r}: keys are never read from a file; put it into the environment, as {KEY}"


def _check(choice: ModelChoice, place: str) -> None:
    """Raises UsageError on numbers that do not go together."""
    low, high = choice.min_concurrency, choice.max_concurrency
    if not 1 <= low <= high:
        raise UsageError(
            f"{place}: concurrency from {low} to {high}; it takes 1 or more, and no less at most than at least"
        )
    for name in ("connect_seconds", "first_seconds", "silence_seconds", "total_seconds"):
        if not 0 < getattr(choice, name) < float("inf"):
            raise UsageError(f"{place}: {name.replace('_', '-')} is {getattr(choice, name):g}; it must be above 0")
    for name in ("retries", "max_cost", "max_tokens_total", "max_seconds"):
        value = getattr(choice, name)
        if value is not None and not value >= 0:
            raise UsageError(f"{place}: {name.replace('_', '-')} is {value:g}; it must be 0 or more")
    for model, price in choice.prices.items():
        if not (price.prompt >= 0 and price.completion >= 0):
            raise UsageError(f"{place}: the prices of {model} must be 0 or more, for a million tokens")
    if choice.base_url and not choice.base_url.startswith(("http://", "https://")):
        raise UsageError(f"{place}: {choice.base_url!r} is no address such as http://127.0.0.1:8000/v1")
    unpriced = sorted({choice.small, choice.large, *choice.models.values()} - choice.prices.keys())
    if choice.max_cost is not None and unpriced:
        raise UsageError(
            f"a limit of cost needs prices, and there is none of {', '.join(unpriced)}: give "
            f'[tool.envcraft.llm.prices."{unpriced[0]}"] prompt and completion, for a million tokens'
        )
