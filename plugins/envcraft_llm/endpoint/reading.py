"""An answer put together of the pieces that an endpoint streams.

The pieces are decoded here, not by the client's own models: an endpoint under load sends tens of thousands a second,
and those that keep to the protocol only nearly have to end as a failure of one request.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import msgspec

from envcraft_llm.model import Answer, ModelFailure

from .harmony import separate

#: What a model says instead of an answer, where it says nothing else.
_REFUSAL = re.compile(
    r"(i['\u2019]?m (very |so )?(sorry|unable)|sorry(,| but)|i can(['\u2019]t|not| not)|i am (sorry|unable))\b",
    re.IGNORECASE,
)
_REFUSAL_LENGTH = 400
#: So much is shown of what an endpoint sent.
_SHOWN = 200
#: A line that does not end is no event stream.
_LONGEST_LINE = 16 * 2**20


class Garbled(Exception):
    """What came is no stream of pieces."""


class Delta(msgspec.Struct):
    content: str | None = None
    reasoning: str | None = None
    reasoning_content: str | None = None
    refusal: str | None = None


class Choice(msgspec.Struct):
    delta: Delta | None = None
    message: Delta | None = None
    finish_reason: str | None = None


class Usage(msgspec.Struct):
    prompt_tokens: int | None = None
    completion_tokens: int | None = None


class Chunk(msgspec.Struct):
    """A piece, or a whole answer of a server that does not stream. One without `choices` tells usage, or an error."""

    choices: list[Choice] | None = None
    usage: Usage | None = None
    model: str | None = None
    error: Any = None


_decoder = msgspec.json.Decoder(Chunk)


def decode(data: bytes) -> Chunk:
    """Raises Garbled on what is no piece."""
    try:
        return _decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError):
        raise Garbled(f"{shown(data)} is no piece of an answer") from None


class Events:
    """The data of the events in a stream of bytes.

    Attributes:
        done: whether ``[DONE]`` has come; what follows it is nothing.
    """

    def __init__(self) -> None:
        self.done = False
        self._rest = b""

    def feed(self, piece: bytes) -> list[bytes]:
        """The data of each event that ends in this piece. Raises Garbled on what is no event stream."""
        *lines, self._rest = (self._rest + piece).split(b"\n")
        if len(self._rest) > _LONGEST_LINE:
            raise Garbled(f"a line goes on after {len(self._rest):,} bytes")
        found = []
        for line in lines:
            data = _data(line)
            self.done = self.done or data == b"[DONE]"
            if data and not self.done:
                found.append(data)
        return found

    def end(self) -> list[bytes]:
        """The data of a last line that lacks its end."""
        return self.feed(b"\n") if self._rest else []


def _data(line: bytes) -> bytes:
    """Raises Garbled."""
    if line.startswith(b"data:"):
        return line[5:].strip()
    line = line.strip()
    # llama.cpp tells errors in a field of their own.
    if line.startswith(b"error:"):
        return b'{"error":' + line[6:] + b"}"
    if not line or line.startswith((b":", b"event:", b"id:", b"retry:")):
        return b""
    raise Garbled(f"{shown(line)} is no event")


class Reading:
    """What has come of one answer. `plain` rids of the key what the model wrote."""

    def __init__(self, plain: Callable[[str], str] = str) -> None:
        self._plain = plain
        self.pieces = 0
        self.usage: Usage | None = None
        self.finish: str | None = None
        self._model = ""
        self._text: list[str] = []
        self._thought: list[str] = []
        self._refusal: list[str] = []

    def take(self, chunk: Chunk) -> None:
        """Add a piece."""
        if chunk.usage is not None:
            self.usage = chunk.usage
        if not chunk.choices:
            return
        choice = chunk.choices[0]
        if choice.finish_reason:
            self.finish = choice.finish_reason
        if chunk.model:
            self._model = chunk.model
        part = choice.delta or choice.message
        if part is None:
            return
        told = False
        for text, kept in (
            (part.content, self._text),
            (part.reasoning_content or part.reasoning, self._thought),
            (part.refusal, self._refusal),
        ):
            if text:
                kept.append(text)
                told = True
        self.pieces += told

    def tokens(self, prompt: int) -> tuple[int, int]:
        """Of prompt and answer. What the endpoint does not tell is estimated: `prompt`, and a token for a piece."""
        told = self.usage or Usage()
        return (
            prompt if told.prompt_tokens is None else told.prompt_tokens,
            self.pieces if told.completion_tokens is None else told.completion_tokens,
        )

    def answer(self, tokens: tuple[int, int], seconds: float) -> Answer:
        """The whole answer. Raises ModelFailure where it is refused or empty."""
        text, leaked = separate(self._plain("".join(self._text)))
        thought = self._plain("".join(self._thought))
        refusal = shown(self._plain("".join(self._refusal)))
        if self._refusal or self.finish == "content_filter":
            raise ModelFailure("refused", f"refused: {refusal or 'by the filter of content'}")
        if not text.strip():
            where = f" after {len(thought) + len(leaked):,} characters of reasoning" if thought or leaked else ""
            cut = ", cut off by the limit of tokens" if self.finish == "length" else ""
            raise ModelFailure("empty", f"the answer is empty{where}{cut}")
        if len(text) < _REFUSAL_LENGTH and _REFUSAL.match(text.strip()):
            raise ModelFailure("refused", f"refused: {shown(text)}")
        return Answer(
            text=text,
            reasoning="\n".join(filter(None, (thought, leaked))),
            finish="length" if self.finish == "length" else "stop",
            prompt_tokens=tokens[0],
            completion_tokens=tokens[1],
            seconds=seconds,
            model=self._model,
        )


def shown(text: str | bytes) -> str:
    """The beginning of what an endpoint sent, in one line that can be printed."""
    plain = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    words = " ".join(plain.split())
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in words[:_SHOWN])
