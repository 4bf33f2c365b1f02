"""The command line: a group whose commands all come from plugins.

Importing this module, and loading the plugins, must import neither NumPy nor Gymnasium: commands do that when they run.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import click

from envcraft import __version__
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.plugins import plugins
from envcraft.pyproject import settings

INTERRUPTED = 130
#: 128 and SIGPIPE: what a shell gives for a program that writes to a pipe that nobody reads any more.
CLOSED = 141


class PluginGroup(click.Group):
    """A group that asks the plugins for its commands."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(command.name for command in offered("envcraft_commands"))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command: click.Command | None = named("envcraft_commands", cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            ctx.fail(f"there is no command {unknown(args[0], self.list_commands(ctx))}")
        return super().resolve_command(ctx, args)

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        # --help imports plugins and writes in here.
        with _ended():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with _ended():
            try:
                return self._invoke(ctx)
            finally:
                # At the interpreter's end a closed pipe would be no exception any more.
                if sys.stdout is not None:
                    sys.stdout.flush()

    def _invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except EnvCraftError as error:
            click.echo(f"Error: {' '.join(str(error).split())}", err=True)
            ctx.exit(error.exit_code)
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except Exception as error:
            # Python's own status for this is 1, which would count the environment as bad.
            import traceback

            traceback.print_exc()
            click.echo(
                f"Error: EnvCraft itself broke ({type(error).__name__}); please report the lines above", err=True
            )
            ctx.exit(ExitCode.ERROR)


class Configured(click.Command):
    """A command whose options may be set in ``[tool.envcraft]`` of the nearest ``pyproject.toml``.

    A setting that only other such commands have is theirs, and so is one of an option that is `apart`.
    """

    apart: frozenset[str] = frozenset()
    _settings: ClassVar[set[str]] = set()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        Configured._settings.update(self._options())

    def _options(self) -> dict[str, str]:
        """What settings may be called, with the parameter that each sets."""
        return {
            option.removeprefix("--"): str(param.name)
            for param in self.params
            if isinstance(param, click.Option)
            for option in param.opts
        }

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        options = {name: param for name, param in self._options().items() if name not in self.apart}
        repeated = {str(param.name) for param in self.params if isinstance(param, click.Option) and param.multiple}
        extra["default_map"] = configuration(Path.cwd(), options, repeated, _settings_of_others)
        return super().make_context(info_name, args, parent, **extra)


def _settings_of_others() -> set[str]:
    # To know them, the commands must have been made.
    offered("envcraft_commands")
    return Configured._settings


class Sharing(click.Command):
    """A command that takes from ``[tool.envcraft]`` what environments promise, where they run and how far apart; the
    other settings are those of judging.
    """

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        _, table = settings(Path.cwd())
        shared = ("contract", "sandbox", "runtime", "require_isolation")
        extra["default_map"] = {
            name: value for key, value in table.items() if (name := key.replace("-", "_")) in shared
        }
        return super().make_context(info_name, args, parent, **extra)


def configuration(
    folder: Path,
    options: dict[str, str],
    repeated: Collection[str] = (),
    others: Callable[[], Collection[str]] = frozenset,
) -> dict[str, Any]:
    """Read ``[tool.envcraft]`` of the ``pyproject.toml`` in `folder` or the nearest one above. Raises UsageError.

    `options` are the names that settings may have, with the parameter that each sets; those parameters that are
    `repeated` get a list, the others one value, of a list with commas in between. `others` gives the
    settings of other commands.
    """
    path, table = settings(folder)
    found: dict[str, Any] = {}
    for key, value in table.items():
        if key in ("contracts", "corpus", "llm"):
            continue
        name = key.replace("_", "-")
        if name not in options and name in others():
            continue
        if name not in options:
            raise UsageError(f"{path}: [tool.envcraft] has no setting {unknown(key, options)}")
        if options[name] in repeated:
            found[options[name]] = value if isinstance(value, list) else [value]
        else:
            found[options[name]] = ",".join(map(str, value)) if isinstance(value, list) else value
    return found


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Put Ctrl-C and SIGTERM off to the end: an extension module that is interrupted while it is imported may swallow
    the exception. Only the main thread is interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    usual = {number: signal.signal(number, lambda n, _: caught.append(n)) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)
    if caught:
        raise KeyboardInterrupt


def offered(hook: str) -> list[Any]:
    """What the plugins give for a hook; on stderr, once, a line for each plugin that is broken."""
    found = plugins().collect(hook)
    _warn()
    return found


def named(hook: str, name: str) -> Any | None:
    """What the plugins give of one name for a hook, or None; fewer plugins are imported than for all of them."""
    found = plugins().find(hook, name)
    _warn()
    return found


def _warn() -> None:
    for broken in plugins().broken:
        line = f"Warning: the plugin {broken.plugin} is broken and left out: {broken.error}"
        if line not in _warned:
            _warned.add(line)
            click.echo(" ".join(line.split()), err=True)


def unknown(name: str, known: Iterable[str]) -> str:
    """Words for a name that does not exist: the name, and the nearest that does, or all of them."""
    import difflib

    known = list(known)
    near = difflib.get_close_matches(name.lower(), [other.lower() for other in known], n=1, cutoff=0.5)
    if near:
        return f"{name!r}; did you mean {next(other for other in known if other.lower() == near[0])}?"
    return f"{name!r}; there are {', '.join(known)}" if known else repr(name)


@contextlib.contextmanager
def _ended() -> Iterator[None]:
    """Give Ctrl-C and closed pipes statuses of their own: Click's and Rich's is 1, which would count an environment as
    bad.
    """
    try:
        yield
    except KeyboardInterrupt:
        click.echo("interrupted", err=True)
        raise click.exceptions.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        _hang_up()
        raise click.exceptions.Exit(CLOSED) from None
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):
            raise click.exceptions.Exit(CLOSED) from None
        raise


def _hang_up() -> None:
    """Have what is still to be written to closed pipes go nowhere, so that the interpreter's end does not complain."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


_warned: set[str] = set()


@click.group(cls=PluginGroup, context_settings={"help_option_names": ["-h", "--help"]}, no_args_is_help=True)
@click.version_option(
    __version__, prog_name="envcraft", message=f"%(prog)s %(version)s (Python {sys.version.split()[0]})"
)
def cli() -> None:
    """Validate generated Gymnasium environments.

    Each environment is run in a sandbox and judged by nine checks; each finding comes with a reproduction.
    """
