"""The interface between the stages and language models: a request, a completion, and the errors in between.

A stage uses `Request`, `Completion` and `Model` and nothing of the network. An endpoint behind its journal, the journal
alone and the recorded demo are all a `Model`.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from typing import Any, Literal

import msgspec

from envcraft.errors import EnvCraftError

#: Why one request has no usable completion. Each kind is counted as the outcome of its concept.
FailureKind = Literal["refused", "empty", "garbage", "context-overflow", "disconnected", "timeout", "server-error"]


class Message(msgspec.Struct, frozen=True):
    """One message of a conversation. `role` is ``system``, ``user`` or ``assistant``."""

    role: Literal["system", "user", "assistant"]
    content: str


class Request(msgspec.Struct, frozen=True):
    """One call of a model.

    Attributes:
        model: Name of the model at the endpoint.
        messages: The conversation so far.
        effort: Reasoning effort (``low``, ``medium``, ``high``), or empty for the endpoint's default.
        max_tokens: Limit on completion tokens, reasoning included; 0 for the endpoint's default.
        temperature: Sampling temperature, or None for the endpoint's default.
        schema: JSON Schema of the completion, or None for text.
        sample: Distinguishes requests that are otherwise equal.
        stage: Stage that sends the request, for usage statistics.
        concept: Id of the concept that the request is about.
        attempt: Number of the attempt at the concept, from 0.
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
        """Return the SHA-256, in hex, of everything that the completion depends on.

        That is every attribute except `stage`, `concept` and `attempt`.
        """
        content = (
            self.model,
            self.messages,
            self.effort,
            self.max_tokens,
            self.temperature,
            self.schema,
            self.sample,
        )
        return hashlib.sha256(msgspec.json.encode(content, order="sorted")).hexdigest()


class Completion(msgspec.Struct, frozen=True):
    """What a model wrote.

    Attributes:
        text: The text, without reasoning and channel markers.
        reasoning: The reasoning, if the endpoint returns it.
        finish: ``stop``, or ``length`` if a token limit cut the text off.
        prompt_tokens: Tokens of the prompt, as the endpoint counts them.
        completion_tokens: Tokens of the completion, reasoning included.
        seconds: Time from sending the request to the end of the completion.
        model: Name of the model that the endpoint reports.
    """

    text: str
    reasoning: str = ""
    finish: Literal["stop", "length"] = "stop"
    prompt_tokens: int = 0
    completion_tokens: int = 0
    seconds: float = 0.0
    model: str = ""


class RequestFailed(Exception):
    """One request failed after all retries; other requests may succeed."""

    def __init__(self, kind: FailureKind, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class ModelUnavailable(EnvCraftError):
    """No request can succeed any more: the endpoint is down, the model does not exist, or the budget is exceeded."""


class Model(ABC):
    """Completes requests. Many tasks of one event loop call `generate` concurrently."""

    @abstractmethod
    async def generate(self, request: Request) -> Completion:
        """Return the completion of a request.

        Raises:
            RequestFailed: If this request failed.
            ModelUnavailable: If no request can succeed.
        """

    async def close(self) -> None:
        """Close connections and files."""
        return
