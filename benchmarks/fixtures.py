"""The fixtures and what each must be judged: the headers of ``tests/fixtures/<check>/good|bad/*.py``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FIXTURES = ROOT / "tests" / "fixtures"

_EXPECT = re.compile(r"^# expect: *(EC\d{3}(?:, *EC\d{3})*)", re.MULTILINE)
_GAME = re.compile(r"^# game: *(\S+)", re.MULTILINE)


@dataclass(frozen=True)
class Fixture:
    """One environment, or one privileged policy with its game. `codes` is empty for good ones."""

    check: str
    path: Path
    codes: frozenset[str]
    policy: Path | None = None

    @property
    def name(self) -> str:
        return str((self.policy or self.path).relative_to(FIXTURES))


def expected(path: Path) -> frozenset[str]:
    """The codes that a file's header, or for a file that is no text its name, expects."""
    if match := re.search(r"\.(EC\d{3})\.py$", path.name):
        return frozenset({match[1]})
    found = _EXPECT.search(path.read_text("utf-8")[:2000])
    return frozenset(re.findall(r"EC\d{3}", found[1])) if found else frozenset()


def fixtures(check: str | None = None) -> list[Fixture]:
    """All fixtures, or those of one check."""
    found = []
    for path in sorted(FIXTURES.glob("*/*/*.py")):
        family, kind = path.parts[-3], path.parts[-2]
        if check not in (None, family):
            continue
        if kind == "policies":
            game = _GAME.search(path.read_text("utf-8"))
            if game is None:
                raise ValueError(f"{path} names no game")
            found.append(Fixture(family, (path.parent / game[1]).resolve(), expected(path), path))
        else:
            codes = expected(path)
            if bool(codes) != (kind == "bad"):
                raise ValueError(f"{path}: a bad fixture has a line '# expect:', a good one has none")
            found.append(Fixture(family, path, codes))
    return found


def examples() -> list[Fixture]:
    """The examples, with what those that are broken on purpose must be judged."""
    return [Fixture("examples", path, expected(path)) for path in sorted((ROOT / "examples").glob("*.py"))]
