"""``[tool.envcraft.llm]``: endpoint, models, prices and limits, and the options that override them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from envcraft.config import settings as pyproject_settings
from envcraft.errors import UsageError
from envcraft.registry import did_you_mean

#: The stages that use the small model.
SMALL_STAGES = frozenset({"elaboration", "briefs", "viability"})
#: The default models.
SMALL, LARGE = "gpt-oss-20b", "gpt-oss-120b"
#: The environment variable that holds the key, and the one that may name another variable.
KEY, KEY_NAME = "OPENAI_API_KEY", "ENVCRAFT_LLM_KEY_ENV"

Effort = Literal["", "low", "medium", "high"]


class Price(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Cost of a million tokens, in any one currency."""

    prompt: float = 0.0
    completion: float = 0.0


class ModelSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename="kebab"):
    """Settings merged with options. Timeouts apply to one attempt, limits to one run.

    Attributes:
        base_url: Address of the endpoint, with ``/v1``; empty if none is configured.
        model: Model of the stages that write code; empty for gpt-oss-120b.
        small_model: Model for elaboration, briefs and viability; empty for `model` if that is given, else gpt-oss-20b.
        models: Models by stage.
        effort: Reasoning effort; empty for the endpoint's default.
        prices: Prices by name of the model.
        min_concurrency: Lower bound of the limit of requests in flight.
        max_concurrency: Upper bound of that limit.
        connect_seconds: Timeout of the connection.
        first_seconds: Timeout of the first chunk, the endpoint's queue included.
        silence_seconds: Timeout between two chunks.
        total_seconds: Timeout of the whole completion.
        retries: Attempts after the first.
        batch: Whether to use the endpoint's Batch interface.
        max_cost: Limit of the cost, in the currency of the prices, or None.
        max_tokens_total: Limit of prompt and completion tokens, or None.
        max_seconds: Seconds from `open_model` after which no request is sent, or None.
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
        """Name of the model that writes code."""
        return self.model or LARGE

    @property
    def small(self) -> str:
        """Name of the model for elaboration, briefs and viability."""
        return self.small_model or self.model or SMALL

    def model_for(self, stage: str) -> str:
        """Return the name of the model for a stage."""
        return self.models.get(stage) or (self.small if stage in SMALL_STAGES else self.large)


def load_settings(folder: Path, options: Mapping[str, Any]) -> ModelSettings:
    """Load ``[tool.envcraft.llm]`` and apply options.

    Args:
        folder: Folder whose nearest ``pyproject.toml``, there or above, is read.
        options: Values by attribute name that override the file; None overrides nothing.

    Raises:
        UsageError: If a setting does not exist or has an invalid value.
    """
    path, table = pyproject_settings(folder)
    place = f"{path}: [tool.envcraft.llm]"
    llm = table.get("llm", {})
    if not isinstance(llm, dict):
        raise UsageError(f"{place} must be a table")
    known = {name: name for name in ModelSettings.__struct_encode_fields__}
    values = {key.replace("_", "-"): value for key, value in llm.items()}
    for key in values:
        if key not in known:
            raise UsageError(f"{place} has no setting {_about_key(key) or did_you_mean(key, known)}")
    try:
        settings = msgspec.convert(values, ModelSettings)
    except msgspec.ValidationError as error:
        raise UsageError(f"{place}: {str(error).replace('`$.', '`')}") from None
    _check(settings, place)
    if not (options.get("base_url") or settings.base_url):
        # The openai client reads this variable too.
        settings = msgspec.structs.replace(settings, base_url=os.environ.get("OPENAI_BASE_URL", ""))
    given = {name: value for name, value in options.items() if value is not None}
    merged = msgspec.structs.replace(settings, **given)
    # --model alone applies to every stage.
    if options.get("model") and not options.get("small_model"):
        merged = msgspec.structs.replace(merged, small_model="", models={})
    _check(merged, "the options")
    return merged


def key_from_environment() -> tuple[str, str]:
    """Return the name of the variable that holds the key, and the key; empty if it is not set."""
    name = os.environ.get(KEY_NAME) or KEY
    return name, os.environ.get(name, "").strip()


def _about_key(name: str) -> str:
    if "key" not in name:
        return ""
    return f"{name!r}: a key is never read from a file; put it into the environment variable {KEY}"


def _check(settings: ModelSettings, place: str) -> None:
    """Raises UsageError if a number is out of range, or numbers contradict each other."""
    low, high = settings.min_concurrency, settings.max_concurrency
    if not 1 <= low <= high:
        raise UsageError(
            f"{place}: concurrency from {low} to {high}; the minimum must be 1 or more, and at most the maximum"
        )
    for name in ("connect_seconds", "first_seconds", "silence_seconds", "total_seconds"):
        if not 0 < getattr(settings, name) < float("inf"):
            raise UsageError(f"{place}: {name.replace('_', '-')} is {getattr(settings, name):g}; it must be above 0")
    for name in ("retries", "max_cost", "max_tokens_total", "max_seconds"):
        value = getattr(settings, name)
        if value is not None and not value >= 0:
            raise UsageError(f"{place}: {name.replace('_', '-')} is {value:g}; it must be 0 or more")
    for model, price in settings.prices.items():
        if not (price.prompt >= 0 and price.completion >= 0):
            raise UsageError(f"{place}: the prices of {model}, per million tokens, must be 0 or more")
    if settings.base_url and not settings.base_url.startswith(("http://", "https://")):
        raise UsageError(f"{place}: {settings.base_url!r} is not an address such as http://127.0.0.1:8000/v1")
    unpriced = sorted({settings.small, settings.large, *settings.models.values()} - settings.prices.keys())
    if settings.max_cost is not None and unpriced:
        raise UsageError(
            f"max-cost needs prices, and {', '.join(unpriced)} has none: set prompt and completion, per million "
            f'tokens, in [tool.envcraft.llm.prices."{unpriced[0]}"]'
        )
