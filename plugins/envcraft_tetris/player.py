"""The player `tetris`: the policy of :mod:`envcraft_tetris.placement`."""

from __future__ import annotations

from pathlib import Path

from envcraft.demonstrations.player import PolicyPlayer
from envcraft.target import PolicyFile


class TetrisPlayer(PolicyPlayer):
    def __init__(self) -> None:
        file = Path(__file__).with_name("placement.py")
        policy = PolicyFile(str(file), file.read_text("utf-8"))
        super().__init__(policy, "tetris", "tries where each falling piece can come to lie", ("tetris",))
