"""The requirements file of ``envcraft sandbox build --packages``: libraries besides the pinned ones."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import msgspec

from envcraft.errors import UsageError

_NAME = r"[A-Za-z0-9](?:[A-Za-z0-9._-]*[A-Za-z0-9])?"
_VERSION = r"[A-Za-z0-9.!+_-]*[A-Za-z0-9]"
_LINE = re.compile(rf"({_NAME})\s*(?:==\s*({_VERSION}))?")


class Package(msgspec.Struct, frozen=True):
    """A library, and its version if the file gives one. `place` is the file and line that names it."""

    name: str
    version: str | None = None
    place: str = ""

    def __str__(self) -> str:
        return self.name + (f"=={self.version}" if self.version else "")

    @property
    def key(self) -> str:
        """The name in its normalized spelling."""
        return re.sub(r"[-_.]+", "-", self.name).lower()


def read(path: str) -> list[Package]:
    """Read ``NAME`` or ``NAME==VERSION``, one per line, with comments. Raises UsageError with file and line.

    Ranges, options, addresses and markers are refused: the contents of an image must not depend on the day of its
    build.
    """
    try:
        text = Path(path).read_text("utf-8")
    except OSError as error:
        raise UsageError(f"--packages {path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"--packages {path} is not text") from None
    found: dict[str, Package] = {}
    for package in _packages(path, text):
        first = found.setdefault(package.key, package)
        if first.version != package.version:
            raise UsageError(f"{package.place}: {package} contradicts {first} at {first.place}")
    if not found:
        raise UsageError(f"--packages {path} names no package; leave the option out")
    return list(found.values())


def _packages(path: str, text: str) -> Iterator[Package]:
    for number, line in enumerate(text.splitlines(), 1):
        words = re.sub(r"(^|\s)#.*", "", line).strip()
        if not words:
            continue
        matched = _LINE.fullmatch(words)
        if matched is None:
            raise UsageError(f"{path}:{number}: {words!r} is not NAME or NAME==VERSION")
        yield Package(matched[1], matched[2], f"{path}:{number}")
