"""The options of a command that asks models."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from .settings import chosen

_OPTIONS = (
    click.option(
        "--base-url",
        metavar="URL",
        help="The endpoint, such as http://127.0.0.1:8000/v1; its key is read from OPENAI_API_KEY.",
    ),
    click.option("--model", metavar="NAME", help="What writes code.  [default: gpt-oss-120b]"),
    click.option(
        "--small-model",
        metavar="NAME",
        help="What writes and judges briefs.  [default: --model where that is given, else gpt-oss-20b]",
    ),
    click.option(
        "--effort", type=click.Choice(["low", "medium", "high"]), help="Of reasoning.  [default: the endpoint's]"
    ),
    click.option(
        "--concurrency",
        "max_concurrency",
        type=click.IntRange(1),
        help="The most requests under way at once; the endpoint's limits lower it.  [default: 64]",
    ),
    click.option(
        "--batch",
        is_flag=True,
        default=None,
        help="Collect requests for the endpoint's Batch interface, which takes hours.",
    ),
    click.option(
        "--max-cost", type=click.FloatRange(0), help="End where this run has cost so much, by the settings' prices."
    ),
    click.option("--max-tokens-total", type=click.IntRange(0), help="End where this run has used so many tokens."),
    click.option("--max-seconds", type=click.FloatRange(0), help="Send no more requests after so long."),
)
_NAMES = (
    *("base_url", "model", "small_model", "effort", "max_concurrency", "batch", "max_cost", "max_tokens_total"),
    "max_seconds",
)


def model_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options of models, resolved against ``[tool.envcraft.llm]`` to one argument `chosen`, a
    `ModelChoice`. What is wrong in them raises UsageError before the command runs.
    """

    @functools.wraps(command)
    def resolved(*args: Any, **options: Any) -> Any:
        own = {name: options.pop(name) for name in _NAMES}
        return command(*args, chosen=chosen(Path.cwd(), own), **options)

    for option in reversed(_OPTIONS):
        resolved = option(resolved)
    return resolved
