"""Endpoints with an OpenAI-compatible interface: client, retries, concurrency limit, usage and journal.

A command takes `model_options` and passes the resulting settings to `open_model`::

    @click.command()
    @model_options
    def generate(model_settings: ModelSettings) -> None:
        model = open_model(model_settings, corpus)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .options import model_options
from .settings import ModelSettings

if TYPE_CHECKING:
    from .factory import JournaledModel, open_model

__all__ = ["JournaledModel", "ModelSettings", "model_options", "open_model"]


def __getattr__(name: str) -> Any:
    # Every command imports the options at its start; the factory needs asyncio.
    if name in ("JournaledModel", "open_model"):
        from . import factory

        return getattr(factory, name)
    raise AttributeError(name)
