"""Telling what a model thought from what it answered, where the endpoint leaves both in one text.

gpt-oss writes in channels: ``<|channel|>analysis<|message|>…<|end|><|start|>assistant<|channel|>final<|message|>…``.
Some servers pass the markers on, whole or in part; other models think between ``<think>`` and ``</think>``.
"""

from __future__ import annotations

import re

_MARKER = re.compile(r"<\|(start|channel|message|constrain|end|return|call)\|>")
_THINKING = re.compile(r"^\s*<think(?:ing)?>(.*?)(?:</think(?:ing)?>|\Z)", re.DOTALL)
_UNOPENED = re.compile(r"^(?!.*<think(?:ing)?>)(.*?)</think(?:ing)?>", re.DOTALL)
#: The name of a channel whose marker before it was eaten as a special token.
_EATEN = re.compile(r"^\s*(?:assistant)?(analysis|commentary)(?=[A-Z\s])(.*?)assistantfinal(.*\S.*)\Z", re.DOTALL)


def separate(text: str) -> tuple[str, str]:
    """What was answered, and what was thought. A text without markers is an answer as it stands."""
    if "<|" in text and _MARKER.search(text):
        return _channels(text)
    for pattern in (_THINKING, _UNOPENED):
        if thought := pattern.match(text):
            return text[thought.end() :].lstrip("\n"), thought.group(1).strip()
    if eaten := _EATEN.match(text):
        return eaten.group(3), eaten.group(2).strip()
    return text, ""


def _channels(text: str) -> tuple[str, str]:
    """Each message goes to where its channel says. One without a channel is a thought where a final answer follows: the
    markers before it were the prompt's; else it is the answer.
    """
    messages: list[tuple[str, str]] = []
    channel, part, place = "", "message", 0
    for marker in _MARKER.finditer(text):
        piece, place = text[place : marker.start()], marker.end()
        if part == "channel":
            channel = piece.split()[0] if piece.strip() else ""
        elif part == "message":
            messages.append((channel, piece))
        name = marker.group(1)
        if name in ("start", "end", "return", "call"):
            channel = ""
        # After the end of a message comes at most a role.
        part = name if name in ("channel", "message") else "header"
    if part == "message":
        messages.append((channel, text[place:]))
    final = "final" if any(name == "final" for name, _ in messages) else ""
    answered = "".join(piece for name, piece in messages if name == final)
    thought = [piece.strip() for name, piece in messages if name != final and piece.strip()]
    return answered.strip("\n"), "\n".join(thought)
