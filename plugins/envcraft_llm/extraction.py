"""The program in a model's answer: out of prose, out of one of several fences, without channel markers."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple

from envcraft.target import parse

_FENCE = re.compile(r"^[ \t]*(`{3,}|~{3,})[ \t]*([\w+#.-]*)[^\n]*$", re.MULTILINE)
_MARKER = re.compile(r"<\|(?:start|end|message|return|call|channel|constrain)\|>")
_CHANNEL = re.compile(r"<\|channel\|>\s*(\w+)[^<]*<\|message\|>")
_THINKING = re.compile(r"<think(?:ing)?>.*?(?:</think(?:ing)?>|\Z)", re.DOTALL)
_PYTHON = {"", "python", "py", "python3"}
#: How a Python file begins, where no fence says so.
_BEGINS = re.compile(r'^(?:from [\w.]+ import |import \w|"""|\'\'\'|class \w+|def \w+\(|#!|@)', re.MULTILINE)
_BASES = {"Env", "GameEnv", "BaseEnv", "ArcadeEnv"}


class Extracted(NamedTuple):
    """A file, and the class in it that is the environment or the policy: "" where there is one, or none that shows."""

    source: str
    name: str = ""


def environment(text: str) -> Extracted | None:
    """The environment in an answer; None where nothing looks like one. A file that does not parse is given all the
    same, where it looks like one: the repair is told what is wrong with it.
    """
    best = _best(text, _environments, r"^class\s+\w+\s*\(.*Env\w*\s*\)|def\s+step\s*\(")
    if best is None:
        return None
    names = _environments(best)
    return Extracted(best, _chosen(names) if len(names) > 1 else "")


def policy(text: str) -> Extracted | None:
    """The privileged policy in an answer; None where nothing looks like one."""
    best = _best(text, _policies, r"def\s+(act|policy)\s*\(")
    return None if best is None else Extracted(best)


def unfinished(text: str) -> bool:
    """Whether an answer ends within a fence."""
    fences = list(_fences(clean(text)))
    return bool(fences) and not fences[-1][2]


def joined(first: str, more: str) -> str:
    """An answer that was cut off, and its continuation: without a fence that it opens anew, without the lines that it
    says again.
    """
    more = clean(more)
    opened = _FENCE.search(more)
    # Words before the fence, such as "Here is the rest", are none of the file.
    if opened is not None and unfinished(first) and _fence_opens(more, opened):
        more = more[opened.end() :].removeprefix("\n")
    for size in range(min(len(first), len(more), 4000), 15, -1):
        if first.endswith(more[:size]):
            return first + more[size:]
    # The last line may have been cut in the middle and be said again from its start.
    begun = first.rsplit("\n", 1)[-1]
    if len(begun.strip()) > 3 and more.lstrip().startswith(begun.strip()):
        return first[: len(first) - len(begun)] + more
    return first + more


def clean(text: str) -> str:
    """An answer without what was thought, and without the markers of channels."""
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


def _best(text: str, names: Callable[[str], list[str]], looks: str) -> str | None:
    """Of all pieces that may be the program, the one that is most like it; of several as good, the longest, then the
    last. All fences of Python together are one where none is the program by itself: some models tell it in parts.
    """
    for pieces in _places(clean(text)):
        scores = [_score(piece, names, looks) for piece in pieces]
        if max(scores, default=0) < 2 and len(pieces) > 1:
            pieces.append("\n\n".join(pieces))
            scores.append(_score(pieces[-1], names, looks))
        good = [(score, len(pieces[number]), number) for number, score in enumerate(scores) if score > 0]
        if good:
            return _tidy(pieces[max(good)[2]])
    return None


def _score(piece: str, names: Callable[[str], list[str]], looks: str) -> int:
    """2 for what parses and defines what is looked for, 1 for what looks like it, 0 for anything else."""
    if names(piece):
        return 2
    return int(re.search(looks, piece, re.MULTILINE) is not None)


def _places(text: str) -> Iterator[list[str]]:
    """The pieces of each place where the program may be, the likeliest first: the fences of Python, those of other
    languages, and everything from the first line of code on.
    """
    fences = list(_fences(text))
    for python in (True, False):
        yield [body for language, body, _ in fences if (language.lower() in _PYTHON) is python]
    if (begins := _BEGINS.search(text)) is not None:
        yield [*_shrinking(text[begins.start() :])]


def _shrinking(text: str) -> Iterator[str]:
    """Code with prose after it: as it is, and up to the last line from which on it parses."""
    yield text
    lines = text.rstrip().split("\n")
    for end in range(len(lines) - 1, max(len(lines) - 40, 1), -1):
        piece = "\n".join(lines[:end])
        if _tree(piece) is not None:
            yield piece
            return


def _fences(text: str) -> Iterator[tuple[str, str, bool]]:
    """Language, content and whether it is closed, of each fence."""
    # Each mark once: a model that says the same over and over writes tens of thousands of them.
    marks = _FENCE.finditer(text)
    for opened in marks:
        closed = next(
            (mark for mark in marks if mark[1][0] == opened[1][0] and len(mark[1]) >= len(opened[1]) and not mark[2]),
            None,
        )
        yield opened[2], text[opened.end() : closed.start() if closed else len(text)].removeprefix("\n"), bool(closed)


def _fence_opens(text: str, mark: re.Match[str]) -> bool:
    """Whether the first fence of a continuation opens one, rather than closing that of the answer before."""
    return bool(mark[2]) or (not text[: mark.start()].strip() and bool(text[mark.end() :].strip()))


def _tidy(piece: str) -> str:
    lines = piece.strip("\n").split("\n")
    # A fence in a list is indented as a whole.
    least = min((len(line) - len(line.lstrip(" ")) for line in lines if line.strip()), default=0)
    return "\n".join(line[least:] for line in lines).rstrip() + "\n"


def _tree(piece: str) -> ast.Module | None:
    try:
        return parse(piece)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


@lru_cache(maxsize=8)
def _environments(piece: str) -> list[str]:
    """The names of classes with ``step`` and ``reset``, in the order of the file; those that others derive from, and
    private ones, are none.
    """
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


def _chosen(names: list[str]) -> str:
    """Of several environments the one that is called as was asked, else the last: helpers come first."""
    return "GameEnv" if "GameEnv" in names else names[-1]
