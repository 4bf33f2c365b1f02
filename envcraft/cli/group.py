"""The command line: a group whose commands all come from plugins.

Neither this module nor loading the plugins imports NumPy or Gymnasium. A command imports them when it runs.
"""

from __future__ import annotations

import os
import shlex
import sys
from itertools import pairwise
from typing import Any

import click

from envcraft.cli.configured import TURNED_OFF
from envcraft.cli.meant import with_the_option_meant
from envcraft.cli.numbers import explained
from envcraft.cli.signals import exit_statuses, is_full
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.registry import did_you_mean, named, offered
from envcraft.version import __version__

#: Characters of a summary in a list of commands.
_LONGEST = 200


class ListingGroup(click.Group):
    """A group whose help wraps the summaries of its commands, where Click cuts them to one line."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(
                [
                    (name, command.get_short_help_str(_LONGEST))
                    for name, command in commands
                    if command is not None and not command.hidden
                ]
            )


class PluginGroup(ListingGroup):
    """A group that collects its commands from the plugins."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(command.name for command in offered("envcraft_commands"))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command: click.Command | None = named("envcraft_commands", cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            if os.path.exists(args[0]):
                ctx.fail(f"{args[0]!r} is not a command; to judge it: {shlex.join(['envcraft', 'validate', args[0]])}")
            ctx.fail(f"there is no command {did_you_mean(args[0], self.list_commands(ctx))}")
        found = super().resolve_command(ctx, args)
        if found[1] is not None and not ctx.resilient_parsing:
            _refuse_empty(ctx, found[1], found[2])
        return found

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        # --help imports the plugins and prints inside this call.
        with exit_statuses():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with exit_statuses():
            try:
                return self._invoke(ctx)
            finally:
                # While the interpreter exits, a closed pipe no longer raises an exception.
                if sys.stdout is not None:
                    sys.stdout.flush()

    def _invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except EnvCraftError as error:
            click.echo(f"Error: {' '.join(error.in_a_command.split())}", err=True)
            # A full disk is no usage error, whichever file could not be written.
            ctx.exit(ExitCode.ERROR if error.__context__ and is_full(error.__context__) else error.exit_code)
        except click.NoSuchOption as error:
            raise with_the_option_meant(error) from None
        except click.BadParameter as error:
            if (words := explained(error)) == error.message:
                raise
            raise click.BadParameter(words, error.ctx, error.param, error.param_hint) from None
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except Exception as error:
            if is_full(error):
                raise
            # Python would exit with 1, which means that an environment fails.
            import traceback

            traceback.print_exc()
            click.echo(
                f"Error: a bug in EnvCraft ({type(error).__name__}); please report the traceback above", err=True
            )
            ctx.exit(ExitCode.ERROR)


def _refuse_empty(ctx: click.Context, command: click.Command, args: list[str]) -> None:
    """Raise UsageError for an empty value, as of a variable that is not set. Click takes an empty path for the folder
    "."."""
    if isinstance(command, click.Group):
        inner = command.get_command(ctx, args[0]) if args else None
        if inner is not None:
            _refuse_empty(ctx, inner, args[1:])
        return
    options = {
        name: param
        for param in command.params
        if isinstance(param, click.Option) and not (param.is_flag or param.count)
        for name in param.opts
    }
    paths = [
        str(each.metavar)
        for each in command.params
        if isinstance(each, click.Argument) and isinstance(each.type, click.Path)
    ]
    for before, word in pairwise(["", *args]):
        name, equals, value = word.partition("=")
        name = name if equals else before
        if value.strip() or not (equals or not word.strip()):
            continue
        if name in options:
            if name.removeprefix("--") not in TURNED_OFF or isinstance(options[name].type, click.Path):
                advice = "" if options[name].required else ", or leave it out"
                raise UsageError(f"{name} is empty; write {name} {options[name].metavar or 'VALUE'}{advice}")
        elif not equals and paths:
            raise UsageError(f"{' or '.join(paths)} is empty; write its path")


@click.group(cls=PluginGroup, context_settings={"help_option_names": ["-h", "--help"]}, no_args_is_help=True)
@click.version_option(
    __version__, prog_name="envcraft", message=f"%(prog)s %(version)s (Python {sys.version.split()[0]})"
)
def cli() -> None:
    """Validate generated Gymnasium environments.

    EnvCraft runs each environment in a sandbox and checks its episodes. Each finding has a reproduction.
    """
