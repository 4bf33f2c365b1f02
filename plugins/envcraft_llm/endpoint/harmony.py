"""Separation of reasoning from the answer, for endpoints that return both in one text.

gpt-oss writes in channels (the harmony format [1]_):
``<|channel|>analysis<|message|>…<|end|><|start|>assistant<|channel|>final<|message|>…``. Some servers pass the markers
on, in whole or in part. Other models write their reasoning between ``<think>`` and ``</think>``.

.. [1] https://github.com/openai/harmony
"""

from __future__ import annotations

import re

_MARKER = re.compile(r"<\|(start|channel|message|constrain|end|return|call)\|>")
_THINKING = re.compile(r"^\s*<think(?:ing)?>(.*?)(?:</think(?:ing)?>|\Z)", re.DOTALL)
_UNOPENED = re.compile(r"^(?!.*<think(?:ing)?>)(.*?)</think(?:ing)?>", re.DOTALL)
#: A channel whose markers the server removed as special tokens.
_STRIPPED = re.compile(r"^\s*(?:assistant)?(analysis|commentary)(?=[A-Z\s])(.*?)assistantfinal(.*\S.*)\Z", re.DOTALL)


def split_reasoning(text: str) -> tuple[str, str]:
    """Return the answer and the reasoning; a text without markers is all answer."""
    if "<|" in text and _MARKER.search(text):
        return _split_channels(text)
    for pattern in (_THINKING, _UNOPENED):
        if match := pattern.match(text):
            return text[match.end() :].lstrip("\n"), match.group(1).strip()
    if match := _STRIPPED.match(text):
        return match.group(3), match.group(2).strip()
    return text, ""


def _split_channels(text: str) -> tuple[str, str]:
    """Assign each message by its channel.

    A message without a channel is reasoning if a final answer follows, since the prompt then ended within the analysis
    channel; otherwise it is the answer.
    """
    messages: list[tuple[str, str]] = []
    channel, part, start = "", "message", 0
    for marker in _MARKER.finditer(text):
        piece, start = text[start : marker.start()], marker.end()
        if part == "channel":
            channel = piece.split()[0] if piece.strip() else ""
        elif part == "message":
            messages.append((channel, piece))
        name = marker.group(1)
        if name in ("start", "end", "return", "call"):
            channel = ""
        # Only a role follows the end of a message.
        part = name if name in ("channel", "message") else "header"
    if part == "message":
        messages.append((channel, text[start:]))
    final = "final" if any(name == "final" for name, _ in messages) else ""
    answer = "".join(piece for name, piece in messages if name == final)
    reasoning = [piece.strip() for name, piece in messages if name != final and piece.strip()]
    return answer.strip("\n"), "\n".join(reasoning)
