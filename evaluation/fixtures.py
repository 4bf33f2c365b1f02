"""The fixtures ``tests/fixtures/<check>/good|bad/*.py`` and the codes that their headers expect."""

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
    """An environment, or a privileged policy with its game. `codes` is empty for a good one."""

    check: str
    path: Path
    codes: frozenset[str]
    policy: Path | None = None

    @property
    def name(self) -> str:
        return str((self.policy or self.path).relative_to(FIXTURES))


def expected(path: Path) -> frozenset[str]:
    """The codes in a file's header, or in its name if the file is not text."""
    if match := re.search(r"\.(EC\d{3})\.py$", path.name):
        return frozenset({match[1]})
    found = _EXPECT.search(path.read_text("utf-8")[:2000])
    return frozenset(re.findall(r"EC\d{3}", found[1])) if found else frozenset()


def fixtures(check: str | None = None) -> list[Fixture]:
    """All fixtures, or those of one check. Raises ValueError if a header does not match its folder."""
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
                raise ValueError(f"{path}: only a bad fixture has a line '# expect:'")
            found.append(Fixture(family, path, codes))
    return found


def examples() -> list[Fixture]:
    """The examples, with the codes of those that are broken on purpose."""
    return [Fixture("examples", path, expected(path)) for path in sorted((ROOT / "examples").glob("*.py"))]
