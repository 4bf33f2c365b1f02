"""``envcraft corpus``: a folder that keeps environments and all verdicts on them.

Only the group is made at start-up; its commands are imported when one of them is asked for.
"""

from __future__ import annotations

import click


class _Late(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(self._made())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return self._made().get(cmd_name)

    def _made(self) -> dict[str, click.Command]:
        from envcraft.corpus.commands import COMMANDS

        return {str(command.name): command for command in COMMANDS}


corpus = _Late("corpus", help="Keep environments and the verdicts on them in a folder, a corpus.", no_args_is_help=True)
