"""What a stage asks of a language model, and what comes back: the seam between the stages and any endpoint.

A stage knows `Request`, `Answer` and `Model`, and nothing of networks. Whatever answers (an endpoint behind its
journal, the journal alone, the demo) is a `Model`.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from typing import Any, Literal

import msgspec

from envcraft.errors import EnvCraftError

#: How one request may end without a usable answer. Each is counted as the outcome of its concept.
FailureKind = Literal["refused", "empty", "garbage", "context-overflow", "disconnected", "timeout", "server-error"]


class Message(msgspec.Struct, frozen=True):
    """One turn of a conversation. `role` is ``system``, ``user`` or ``assistant``."""

    role: Literal["system", "user", "assistant"]
    content: str


class Request(msgspec.Struct, frozen=True):
    """One call of a model.

    Attributes:
        model: its name at the endpoint.
        messages: the conversation so far.
        effort: of reasoning (``low``, ``medium``, ``high``), or empty for the endpoint's own.
        max_tokens: of the answer, reasoning included; 0 for the endpoint's own limit.
        temperature: of sampling, or None for the endpoint's own.
        schema: the JSON Schema that the answer should follow, or None for text.
        sample: tells apart requests that are otherwise the same.
        stage: which stage asks, for the accounts.
        concept: the id of the concept that it is about.
        attempt: the number of the attempt at it, from 0.
    """

    model: str
    messages: tuple[Message, ...]
    effort: str = ""
    max_tokens: int = 0
    temperature: float | None = None
    schema: dict[str, Any] | None = None
    sample: int = 0
    stage: str = ""
    concept: str = ""
    attempt: int = 0

    def key(self) -> str:
        """The SHA-256, in hex, of all that the answer depends on: of everything but stage, concept and attempt."""
        asked = (
            self.model,
            self.messages,
            self.effort,
            self.max_tokens,
            self.temperature,
            self.schema,
            self.sample,
        )
        return hashlib.sha256(msgspec.json.encode(asked, order="sorted")).hexdigest()


class Answer(msgspec.Struct, frozen=True):
    """What a model wrote.

    Attributes:
        text: the answer, without reasoning and channel markers.
        reasoning: what it thought, where the endpoint tells.
        finish: ``stop``, or ``length`` where the limit cut it off.
        prompt_tokens, completion_tokens: as the endpoint counts them, reasoning included.
        seconds: from sending the request to the end of the answer.
        model: what the endpoint says answered.
    """

    text: str
    reasoning: str = ""
    finish: Literal["stop", "length"] = "stop"
    prompt_tokens: int = 0
    completion_tokens: int = 0
    seconds: float = 0.0
    model: str = ""


class ModelFailure(Exception):
    """One request came to nothing, after all retries; other requests may go on."""

    def __init__(self, kind: FailureKind, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class ModelStopped(EnvCraftError):
    """No request can be answered any more: the endpoint is down, the model's name is wrong, or the budget is spent."""


class Model(ABC):
    """Answers requests. `ask` is called from many tasks of one event loop at once."""

    @abstractmethod
    async def ask(self, request: Request) -> Answer:
        """The answer. Raises ModelFailure for this request alone, ModelStopped where none can be answered."""

    async def close(self) -> None:
        """Let go of connections and files."""
        return
