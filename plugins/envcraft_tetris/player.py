"""The player `tetris`, which plays by the policy in :mod:`envcraft_tetris.placement`."""

from __future__ import annotations

from pathlib import Path

from envcraft.demonstrations.player import PolicyPlayer
from envcraft.model.target import PolicyFile


class TetrisPlayer(PolicyPlayer):
    """Rates the board after every placement of the falling piece and plays the best.

    Recordings identify their player by the text of ``placement.py``. Any edit of that file, comments included, makes
    existing recordings those of another version.
    """

    def __init__(self) -> None:
        file = Path(__file__).with_name("placement.py")
        policy = PolicyFile(str(file), file.read_text("utf-8"))
        super().__init__(policy, "tetris", "rates every placement of the falling piece and plays the best", ("tetris",))
