"""The commands ``train``, ``evaluate`` and ``study``, the check ``learnability``, and trained policies as players."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    import click

    from envcraft.demonstrations.player import PlayerLoader
    from envcraft.judging.check import Check


@hookimpl
def envcraft_commands() -> list[click.Command]:
    from envcraft_dqn.commands import evaluate, train
    from envcraft_dqn.study.commands import study

    return [evaluate, train, study]


@hookimpl
def envcraft_checks() -> list[Check]:
    from envcraft_dqn.learnability import Learnability

    return [Learnability()]


@hookimpl
def envcraft_player_loaders() -> list[PlayerLoader]:
    from envcraft_dqn.player import CheckpointLoader

    return [CheckpointLoader()]
