"""The command line options of a command that uses models."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from .settings import load_settings

_OPTIONS = (
    click.option(
        "--base-url",
        metavar="URL",
        help="Address of the endpoint, such as http://127.0.0.1:8000/v1. The key is read from OPENAI_API_KEY.",
    ),
    click.option("--model", metavar="NAME", help="Model that writes code.  [default: gpt-oss-120b]"),
    click.option(
        "--small-model",
        metavar="NAME",
        help="Model that writes and reviews briefs.  [default: --model if given, else gpt-oss-20b]",
    ),
    click.option(
        "--effort",
        type=click.Choice(["low", "medium", "high"]),
        help="Reasoning effort of the models.  [default: that of the endpoint]",
    ),
    click.option(
        "--concurrency",
        "max_concurrency",
        type=click.IntRange(1),
        help="Maximum number of requests in flight. Rate limits of the endpoint lower it.  [default: 64]",
    ),
    click.option(
        "--batch",
        is_flag=True,
        default=None,
        help="Send requests through the endpoint's Batch interface, which is cheaper and takes hours.",
    ),
    click.option(
        "--max-cost",
        type=click.FloatRange(0),
        help="End the run before its cost exceeds this limit, by the configured prices.",
    ),
    click.option(
        "--max-tokens-total", type=click.IntRange(0), help="End the run before it uses more than this many tokens."
    ),
    click.option("--max-seconds", type=click.FloatRange(0), help="Send no request after this many seconds."),
)
_NAMES = (
    *("base_url", "model", "small_model", "effort", "max_concurrency", "batch", "max_cost", "max_tokens_total"),
    "max_seconds",
)


def model_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of models to a command.

    The command gets one argument `model_settings`, the options merged with ``[tool.envcraft.llm]``. Invalid values
    raise UsageError before the command runs.
    """

    @functools.wraps(command)
    def with_settings(*args: Any, **options: Any) -> Any:
        given = {name: options.pop(name) for name in _NAMES}
        return command(*args, model_settings=load_settings(Path.cwd(), given), **options)

    for option in reversed(_OPTIONS):
        with_settings = option(with_settings)
    return with_settings
