"""Endpoints with an OpenAI-compatible interface, and what lies between them and the stages: journal, pace and accounts.

A command takes `model_options` and gives the choice that comes of them to `open_model`::

    @click.command()
    @model_options
    def generate(chosen: ModelChoice) -> None:
        model = open_model(chosen, corpus)
"""

from __future__ import annotations

from .opening import OpenedModel, open_model
from .options import model_options
from .settings import ModelChoice

__all__ = ["ModelChoice", "OpenedModel", "model_options", "open_model"]
