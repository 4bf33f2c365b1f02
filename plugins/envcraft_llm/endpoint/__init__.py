"""Endpoints with an OpenAI-compatible interface, and what lies between them and the stages: journal, pace and accounts.

A command takes `model_options` and gives the choice that comes of them to `open_model`::

    @click.command()
    @model_options
    def generate(chosen: ModelChoice) -> None:
        model = open_model(chosen, corpus)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .options import model_options
from .settings import ModelChoice

if TYPE_CHECKING:
    from .opening import OpenedModel, open_model

__all__ = ["ModelChoice", "OpenedModel", "model_options", "open_model"]


def __getattr__(name: str) -> Any:
    # The options are asked for at the start of every command, and what opens a model needs asyncio.
    if name in ("OpenedModel", "open_model"):
        from . import opening

        return getattr(opening, name)
    raise AttributeError(name)
