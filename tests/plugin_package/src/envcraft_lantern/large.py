"""The contract ``arcade-large``: the arcade's games in larger frames."""

from __future__ import annotations

import msgspec

from envcraft.contracts.builtin import ARCADE

ARCADE_LARGE = msgspec.structs.replace(
    ARCADE,
    name="arcade-large",
    summary="as arcade, in frames of 128x128",
    observation={"type": "Box", "low": 0, "high": 255, "shape": [128, 128, 3], "dtype": "uint8"},
)
