"""The good games that are mutated: of several authors' styles, all of them end, and all can be won or score points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from evaluation.fixtures import FIXTURES, ROOT

_OWN = Path(__file__).resolve().parent / "games"
_EXAMPLES = ("breakout", "crossing", "dungeon", "invaders", "lander", "platformer", "snake", "sokoban")
_FIXTURES = (
    "api/copied_buffer",
    "api/numpy_flags",
    "api/own_action_copy",
    "api/rich_info",
    "determinism/drawn_while_played",
    "determinism/level_cache",
    "determinism/sorted_set",
    "difficulty/lighthouse",
    "difficulty/two_keys",
    "instadeath/minefield",
    "instadeath/slow_fall",
    "instadeath/slow_hunger",
    "instadeath/three_lives",
    "instadeath/unlucky_start",
    "instawin/sword_duel",
    "observation/scrolling_desert",
    "observation/starfield_shooter",
    "observation/static_panel",
    "observation/strobe_paddle",
    "observation/tar_pits",
    "reward/impatient_audience",
    "termination/frozen_after_end",
    "termination/short_rounds",
)


@dataclass(frozen=True)
class Game:
    """One base game under its contract."""

    name: str
    path: Path
    contract: str = "arcade"


def games(folder: Path | None = None) -> list[Game]:
    """All base games by name, or those of a folder of files under the contract `arcade-native`."""
    found = _games() if folder is None else (Game(path.stem, path, "arcade-native") for path in folder.glob("*.py"))
    return sorted(found, key=lambda game: game.name)


def _games() -> Iterator[Game]:
    for name in _EXAMPLES:
        yield Game(name, ROOT / "examples" / f"{name}.py")
    for name in _FIXTURES:
        check, file = name.split("/")
        yield Game(file, FIXTURES / check / "good" / f"{file}.py")
    yield Game("maze_walk", ROOT / "benchmarks" / "games" / "maze_walk.py")
    for path in _OWN.glob("*.py"):
        native = path.read_text("utf-8").startswith("# contract: arcade-native")
        yield Game(path.stem, path, "arcade-native" if native else "arcade")
