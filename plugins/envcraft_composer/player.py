"""The player `composer`, which plays by the policy in :mod:`envcraft_composer.policy`."""

from __future__ import annotations

from pathlib import Path

from envcraft.demonstrations.player import PolicyPlayer, policy_with_planning


class ComposerPlayer(PolicyPlayer):
    """Plans on copies of the game from one step of progress to the next."""

    def __init__(self) -> None:
        policy = policy_with_planning(Path(__file__).with_name("policy.py"))
        super().__init__(policy, "composer", "searches copies of the game for the next success", ("composer",))
