"""Parsing of responses: server-sent events, chunks, and the completion that they add up to.

Chunks are decoded here and not by the client's own models: a busy endpoint sends tens of thousands per second, and a
response that violates the protocol must fail one request only.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import msgspec

from envcraft_llm.model import Completion, RequestFailed

from .harmony import split_reasoning

#: How a refusal begins that is the whole completion.
_REFUSAL = re.compile(
    r"(i['\u2019]?m (very |so )?(sorry|unable)|sorry(,| but)|i can(['\u2019]t|not| not)|i am (sorry|unable))\b",
    re.IGNORECASE,
)
#: Characters below which a text may be a refusal, of an excerpt, and of a line of an event stream.
_REFUSAL_LENGTH, _EXCERPT_LENGTH, _LINE_LENGTH = 400, 200, 16 * 2**20


class MalformedResponse(Exception):
    """The response is not a stream of completion chunks."""


class Delta(msgspec.Struct):
    content: str | None = None
    reasoning: str | None = None
    reasoning_content: str | None = None
    refusal: str | None = None


class Choice(msgspec.Struct):
    delta: Delta | None = None
    message: Delta | None = None
    finish_reason: str | None = None


class ChunkUsage(msgspec.Struct):
    prompt_tokens: int | None = None
    completion_tokens: int | None = None


class Chunk(msgspec.Struct):
    """A chunk of a stream, or the whole response of a server that does not stream.

    A chunk without `choices` reports usage or an error.
    """

    choices: list[Choice] | None = None
    usage: ChunkUsage | None = None
    model: str | None = None
    error: Any = None


_decoder = msgspec.json.Decoder(Chunk)


def decode_chunk(data: bytes) -> Chunk:
    """Decode a chunk. Raises MalformedResponse."""
    try:
        return _decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError):
        raise MalformedResponse(f"{excerpt(data)} is not a completion chunk") from None


class EventStreamDecoder:
    """Decodes server-sent events.

    Attributes:
        done: Whether ``[DONE]`` has arrived; later data is ignored.
    """

    def __init__(self) -> None:
        self.done = False
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the data of each event that is complete now. Raises MalformedResponse."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > _LINE_LENGTH:
            raise MalformedResponse(f"a line of the event stream exceeds {len(self._rest):,} bytes")
        events = []
        for line in lines:
            event = _event_data(line)
            self.done = self.done or event == b"[DONE]"
            if event and not self.done:
                events.append(event)
        return events

    def flush(self) -> list[bytes]:
        """Return the data of a last line without a line break."""
        return self.feed(b"\n") if self._rest else []


def _event_data(line: bytes) -> bytes:
    """Raises MalformedResponse."""
    if line.startswith(b"data:"):
        return line[5:].strip()
    line = line.strip()
    # llama.cpp sends errors in a field of their own.
    if line.startswith(b"error:"):
        return b'{"error":' + line[6:] + b"}"
    if not line or line.startswith((b":", b"event:", b"id:", b"retry:")):
        return b""
    raise MalformedResponse(f"{excerpt(line)} is not a server-sent event")


class CompletionBuilder:
    """Builds a completion from chunks.

    Args:
        redact: Removes the key from what the model wrote.

    Attributes:
        chunks: Number of chunks with text.
        usage: Usage that the endpoint reported, if it did.
        finish: Finish reason, once there is one.
    """

    def __init__(self, redact: Callable[[str], str] = str) -> None:
        self._redact = redact
        self.chunks = 0
        self.usage: ChunkUsage | None = None
        self.finish: str | None = None
        self._model = ""
        self._text: list[str] = []
        self._reasoning: list[str] = []
        self._refusal: list[str] = []

    def add(self, chunk: Chunk) -> None:
        """Add a chunk."""
        if chunk.usage is not None:
            self.usage = chunk.usage
        if not chunk.choices:
            return
        choice = chunk.choices[0]
        if choice.finish_reason:
            self.finish = choice.finish_reason
        if chunk.model:
            self._model = chunk.model
        delta = choice.delta or choice.message
        if delta is None:
            return
        has_text = False
        for text, parts in (
            (delta.content, self._text),
            (delta.reasoning_content or delta.reasoning, self._reasoning),
            (delta.refusal, self._refusal),
        ):
            if text:
                parts.append(text)
                has_text = True
        self.chunks += has_text

    def tokens(self, prompt_tokens: int) -> tuple[int, int]:
        """Return the tokens of prompt and completion.

        Args:
            prompt_tokens: Estimate to return if the endpoint does not report usage; a chunk then counts as one token
                of the completion.
        """
        usage = self.usage or ChunkUsage()
        return (
            prompt_tokens if usage.prompt_tokens is None else usage.prompt_tokens,
            self.chunks if usage.completion_tokens is None else usage.completion_tokens,
        )

    def build(self, tokens: tuple[int, int], seconds: float) -> Completion:
        """Return the completion.

        Raises:
            RequestFailed: If the model refused, or wrote nothing.
        """
        text, leaked = split_reasoning(self._redact("".join(self._text)))
        reasoning = self._redact("".join(self._reasoning))
        refusal = excerpt(self._redact("".join(self._refusal)))
        if self._refusal or self.finish == "content_filter":
            raise RequestFailed("refused", f"refused: {refusal or 'by the content filter'}")
        if not text.strip():
            where = f" after {len(reasoning) + len(leaked):,} characters of reasoning" if reasoning or leaked else ""
            cut = ", cut off by the token limit" if self.finish == "length" else ""
            raise RequestFailed("empty", f"the completion is empty{where}{cut}")
        if len(text) < _REFUSAL_LENGTH and _REFUSAL.match(text.strip()):
            raise RequestFailed("refused", f"refused: {excerpt(text)}")
        return Completion(
            text=text,
            reasoning="\n".join(filter(None, (reasoning, leaked))),
            finish="length" if self.finish == "length" else "stop",
            prompt_tokens=tokens[0],
            completion_tokens=tokens[1],
            seconds=seconds,
            model=self._model,
        )


def excerpt(text: str | bytes) -> str:
    """Return the beginning of a response as one printable line."""
    plain = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    line = " ".join(plain.split())
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in line[:_EXCERPT_LENGTH])
