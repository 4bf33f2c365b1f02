"""Extraction of the program from a completion with prose, fences and channel markers."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple

from envcraft.model.target import parse

_FENCE = re.compile(r"^[ \t]*(`{3,}|~{3,})[ \t]*([\w+#.-]*)[^\n]*$", re.MULTILINE)
_MARKER = re.compile(r"<\|(?:start|end|message|return|call|channel|constrain)\|>")
_CHANNEL = re.compile(r"<\|channel\|>\s*(\w+)[^<]*<\|message\|>")
_THINKING = re.compile(r"<think(?:ing)?>.*?(?:</think(?:ing)?>|\Z)", re.DOTALL)
_PYTHON = {"", "python", "py", "python3"}
#: The first line of Python code outside a fence.
_CODE_START = re.compile(r'^(?:from [\w.]+ import |import \w|"""|\'\'\'|class \w+|def \w+\(|#!|@)', re.MULTILINE)
_BASES = {"Env", "GameEnv", "BaseEnv", "ArcadeEnv"}


class ExtractedFile(NamedTuple):
    """A file, and its environment class if it has several; otherwise the name is ""."""

    source: str
    name: str = ""


def environment(text: str) -> ExtractedFile | None:
    """Return the environment in a completion; None if nothing looks like one.

    A file that looks like an environment but does not parse is returned too, so that it can be repaired.
    """
    best = _best(text, _environments, r"^class\s+\w+\s*\(.*Env\w*\s*\)|def\s+step\s*\(")
    if best is None:
        return None
    names = _environments(best)
    return ExtractedFile(best, _preferred(names) if len(names) > 1 else "")


def policy(text: str) -> ExtractedFile | None:
    """Return the privileged policy in a completion; None if nothing looks like one."""
    best = _best(text, _policies, r"def\s+(act|policy)\s*\(")
    return None if best is None else ExtractedFile(best)


def is_unfinished(text: str) -> bool:
    """Whether a completion ends within a fence."""
    fences = list(_fences(strip_markup(text)))
    return bool(fences) and not fences[-1][2]


def join(first: str, more: str) -> str:
    """Join a completion that was cut off with its continuation, without a reopened fence and repeated lines."""
    more = strip_markup(more)
    opened = _FENCE.search(more)
    # Prose before the fence, such as "Here is the rest", is not part of the file.
    if opened is not None and is_unfinished(first) and _fence_opens(more, opened):
        more = more[opened.end() :].removeprefix("\n")
    for size in range(min(len(first), len(more), 4000), 15, -1):
        if first.endswith(more[:size]):
            return first + more[size:]
    # The continuation may repeat the last line from its start.
    last = first.rsplit("\n", 1)[-1]
    if len(last.strip()) > 3 and more.lstrip().startswith(last.strip()):
        return first[: len(first) - len(last)] + more
    return first + more


def strip_markup(text: str) -> str:
    """Return a completion without reasoning and channel markers."""
    text = text.replace("\r\n", "\n").lstrip("\ufeff")
    if _MARKER.search(text):
        channels = list(_CHANNEL.finditer(text))
        final = next((found for found in reversed(channels) if found[1] == "final"), None)
        if final is not None:
            text = text[final.end() :]
        elif channels and not _FENCE.search(text[: channels[0].start()]):
            text = text[channels[-1].end() :]
        text = _MARKER.sub("", text)
    return _THINKING.sub("", text)


def _best(text: str, names: Callable[[str], list[str]], pattern: str) -> str | None:
    """Return the best candidate: by score, then by length, then the last one.

    If no fence is the program by itself, all Python fences together are a candidate: some models split the program.

    Args:
        text: The completion.
        names: Returns the names of matching definitions in a piece that parses.
        pattern: Matches a piece that looks like the program.
    """
    for pieces in _candidates(strip_markup(text)):
        scores = [_score(piece, names, pattern) for piece in pieces]
        if max(scores, default=0) < 2 and len(pieces) > 1:
            pieces.append("\n\n".join(pieces))
            scores.append(_score(pieces[-1], names, pattern))
        good = [(score, len(pieces[number]), number) for number, score in enumerate(scores) if score > 0]
        if good:
            return _tidy(pieces[max(good)[2]])
    return None


def _score(piece: str, names: Callable[[str], list[str]], pattern: str) -> int:
    """Return 2 if the piece parses and has a matching definition, 1 if it looks like one, else 0."""
    if names(piece):
        return 2
    return int(re.search(pattern, piece, re.MULTILINE) is not None)


def _candidates(text: str) -> Iterator[list[str]]:
    """Yield groups of pieces that may be the program, the most likely group first.

    The groups are Python fences, other fences, and the text from the first line of code on.
    """
    fences = list(_fences(text))
    for python in (True, False):
        yield [body for language, body, _ in fences if (language.lower() in _PYTHON) is python]
    if (start := _CODE_START.search(text)) is not None:
        yield [*_shrinking(text[start.start() :])]


def _shrinking(text: str) -> Iterator[str]:
    """Yield code that prose may follow: the whole text, and the longest prefix of it that parses."""
    yield text
    lines = text.rstrip().split("\n")
    for end in range(len(lines) - 1, max(len(lines) - 40, 1), -1):
        piece = "\n".join(lines[:end])
        if _tree(piece) is not None:
            yield piece
            return


def _fences(text: str) -> Iterator[tuple[str, str, bool]]:
    """Yield the language and the content of each fence, and whether the fence is closed."""
    # One pass over the marks: a model that repeats itself writes tens of thousands of them.
    marks = _FENCE.finditer(text)
    for opened in marks:
        closed = next(
            (mark for mark in marks if mark[1][0] == opened[1][0] and len(mark[1]) >= len(opened[1]) and not mark[2]),
            None,
        )
        yield opened[2], text[opened.end() : closed.start() if closed else len(text)].removeprefix("\n"), bool(closed)


def _fence_opens(text: str, mark: re.Match[str]) -> bool:
    """Whether the first fence of a continuation opens a block, rather than closing the open one."""
    return bool(mark[2]) or (not text[: mark.start()].strip() and bool(text[mark.end() :].strip()))


def _tidy(piece: str) -> str:
    lines = piece.strip("\n").split("\n")
    # A fence within a list item is indented.
    least = min((len(line) - len(line.lstrip(" ")) for line in lines if line.strip()), default=0)
    return "\n".join(line[least:] for line in lines).rstrip() + "\n"


def _tree(piece: str) -> ast.Module | None:
    try:
        return parse(piece)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


@lru_cache(maxsize=8)
def _environments(piece: str) -> list[str]:
    """Return the names of public classes with ``step`` and ``reset``, in file order, without base classes of others."""
    tree = _tree(_tidy(piece))
    if tree is None:
        return []
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    bases = {name for node in classes for name in map(_last_name, node.bases)}
    found = []
    for node in classes:
        methods = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
        derived = any(_last_name(base) in _BASES | {other.name for other in classes} for base in node.bases)
        if (derived and "step" in methods) or {"step", "reset"} <= methods:
            found.append(node.name)
    return [name for name in found if name not in bases and not name.startswith("_")]


def _policies(piece: str) -> list[str]:
    tree = _tree(_tidy(piece))
    if tree is None:
        return []
    return [
        node.name
        for node in tree.body
        if (isinstance(node, ast.FunctionDef) and node.name == "policy")
        or (
            isinstance(node, ast.ClassDef)
            and any(isinstance(part, ast.FunctionDef) and part.name == "act" for part in node.body)
        )
    ]


def _last_name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _preferred(names: list[str]) -> str:
    """Return ``GameEnv``, the name that the prompt requires, else the last class, since helpers come first."""
    return "GameEnv" if "GameEnv" in names else names[-1]
