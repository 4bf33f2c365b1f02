"""A model, put together of its parts as a command wants it."""

from __future__ import annotations

from pathlib import Path

from envcraft_llm.model import Answer, Model, Request

from .settings import ModelChoice


class OpenedModel(Model):
    """An endpoint behind its journal, at a pace that it can keep up, with accounts.

    Attributes:
        accounts: tokens, cost and outcomes by stage, and the rate of tokens.
        limit: how many requests may be under way now.
    """


def open_model(chosen: ModelChoice, journal: Path | None, offline: bool = False) -> OpenedModel:
    """The model that `chosen` describes. It may be opened outside of an event loop, and is used in one.

    Args:
        chosen: what `model_options` gives.
        journal: the file that keeps what was answered, or the folder (a corpus) in which it is ``journal.sqlite``; made
            where it does not exist. None keeps nothing.
        offline: ask nobody: what is not in the journal raises ModelStopped.

    Raises UsageError where no endpoint is named, or the ``llm`` extra is not installed.
    """
    raise NotImplementedError
