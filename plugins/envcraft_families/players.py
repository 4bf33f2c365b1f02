"""The players of the families, which play by the policies in :mod:`envcraft_families.policies`."""

from __future__ import annotations

from pathlib import Path

from envcraft.demonstrations.player import PolicyPlayer, policy_with_planning

#: What each player does, by the family that it plays.
SUMMARIES = {
    "breakout": "moves to where the ball comes down, and aims its next flight at the bricks",
    "maze": "takes the shortest way to the next key, door or gem, searched on copies of the game",
    "shooter": "moves to where a bullet meets an enemy, fires only bullets that hit, and avoids shots",
    "snake": "takes the shortest way to a meal from which the tail can still be reached",
}


def players() -> list[PolicyPlayer]:
    """A player for each family, of the same name."""
    folder = Path(__file__).with_name("policies")
    return [
        PolicyPlayer(policy_with_planning(folder / f"{name}.py"), name, summary, (name,))
        for name, summary in SUMMARIES.items()
    ]
