"""The group ``envcraft corpus``, whose commands are imported when one of them is used."""

from __future__ import annotations

import click


class _LazyGroup(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(self._commands())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return self._commands().get(cmd_name)

    def _commands(self) -> dict[str, click.Command]:
        from envcraft.cli.commands.corpus import COMMANDS

        return {str(command.name): command for command in COMMANDS}


corpus = _LazyGroup("corpus", help="Manage a corpus of environments and their verdicts.", no_args_is_help=True)
