"""Commands that take defaults for their options from ``[tool.envcraft]`` of the nearest ``pyproject.toml``."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import click
from click.core import ParameterSource

from envcraft.cli.numbers import explained
from envcraft.config import settings
from envcraft.errors import EnvCraftError, UsageError
from envcraft.registry import did_you_mean, offered

_E = TypeVar("_E", bound=EnvCraftError)
#: The settings that an empty value turns off. Any other empty value is an error.
TURNED_OFF = frozenset({"baseline", "ignore", "output", "policy", "skip"})
#: A command in a message, or an option with its value.
_VALUE = re.compile(r"`[^`]*`|--([\w-]+) (?=')")


class Configured(click.Command):
    """A command whose every option can be set in ``[tool.envcraft]``.

    A setting that this command lacks and another such command has is ignored here; any other unknown setting is an
    error.

    Attributes:
        apart: settings that this command ignores although it has an option of that name.
    """

    apart: frozenset[str] = frozenset()
    _settings: ClassVar[set[str]] = set()

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        Configured._settings.update(self._options())

    def _options(self) -> dict[str, str]:
        """Map the names of settings to the parameters that they set."""
        return {
            option.removeprefix("--"): str(param.name)
            for param in self.params
            if isinstance(param, click.Option)
            for option in param.opts
            if option.startswith("--")
        }

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        extra["default_map"] = self._defaults(Path.cwd())
        with _blaming_the_file():
            return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with _blaming_the_file(ctx):
            return super().invoke(ctx)

    def read(self, folder: Path) -> dict[str, Any]:
        """Read the settings as this command does; pytest and Python have no command line to read.

        Args:
            folder: where the search for the file starts.

        Returns:
            The values of the settings that the file holds, by parameter.

        Raises:
            UsageError: the file is malformed, or a setting or its value does not exist.
        """
        found = self._defaults(folder)
        with _blaming_the_file(folder=folder), click.Context(self, default_map=found) as ctx:
            return {
                str(param.name): param.handle_parse_result(ctx, {}, [])[0]
                for param in self.params
                if param.name in found
            }

    def _defaults(self, folder: Path) -> dict[str, Any]:
        options = {name: param for name, param in self._options().items() if name not in self.apart}
        repeated = {str(param.name) for param in self.params if isinstance(param, click.Option) and param.multiple}
        found = configuration(folder, options, repeated, settings_of_all_commands)
        flags = {param.name for param in self.params if isinstance(param, click.Option) and param.is_flag}
        numbers = {param.name for param in self.params if isinstance(param.type, click.IntRange | click.FloatRange)}
        for option, name in options.items():
            if name in flags and not isinstance(found.get(name, False), bool):
                raise UsageError(f"{place(option, folder)}: {found[name]!r} is neither true nor false")
            if name in numbers and isinstance(found.get(name), str):
                raise UsageError(f"{place(option, folder)}: {found[name]!r} is a string; write a number without quotes")
        # Click takes 1.5 for a whole number and True for 1, but not their texts.
        return {
            name: value if isinstance(value, list) or name in flags else _text(value) for name, value in found.items()
        }


def _text(value: Any) -> str:
    """A value as the file writes it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def settings_of_all_commands() -> set[str]:
    """The settings of every command that judges."""
    # Making a command registers its settings.
    offered("envcraft_commands")
    return Configured._settings


class PartlyConfigured(click.Command):
    """A command that takes only the contract and the sandbox from ``[tool.envcraft]``.

    The other settings are about judging, which such a command does not do.
    """

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        _, table = settings(Path.cwd())
        shared = ("contract", "sandbox", "runtime", "require_isolation")
        extra["default_map"] = {
            name: value for key, value in table.items() if (name := key.replace("-", "_")) in shared
        }
        with _blaming_the_file():
            return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with _blaming_the_file(ctx):
            return super().invoke(ctx)


@contextlib.contextmanager
def _blaming_the_file(ctx: click.Context | None = None, folder: Path | None = None) -> Iterator[None]:
    """Let an error about a value of ``[tool.envcraft]`` name the file and the setting, not an option.

    Args:
        ctx: the command's context, None while it is made: Click's error has it then.
        folder: the folder whose settings are read, by default the working directory.

    Raises:
        UsageError: such a value is wrong.
    """
    try:
        yield
    except click.BadParameter as error:
        if error.param is None or not _configured(ctx or error.ctx, error.param):
            raise
        option = max(error.param.opts, key=len)
        raise UsageError(f"{place(option.removeprefix('--'), folder)}: {explained(error)}") from None
    except EnvCraftError as error:
        if ctx is None or (other := blamed(ctx, error)) is error:
            raise
        raise other from None


def blamed(ctx: click.Context, error: _E) -> _E:
    """Return an error that names the file and the settings whose values are from there; else the error itself."""
    names = [
        option.removeprefix("--") for param in ctx.command.params if _configured(ctx, param) for option in param.opts
    ]
    if error.setting in names:
        error = of_the_file(error, Path.cwd())
        return renamed(error, {name: name for name in names})
    return renamed(error, {name: place(name) for name in names})


def of_the_file(error: _E, folder: Path) -> _E:
    """Return an error that names the file and the setting, where `error` may name the option."""
    option = f"--{error.setting}"
    words = str(error).removeprefix(f"{option} ").removeprefix(f"{option}: ")
    return type(error)(f"{place(error.setting, folder)}: {words}")


def renamed(error: _E, names: Mapping[str, str]) -> _E:
    """Return an error that names where values are from, instead of their options; the error itself if it names none.
    Commands in backticks keep their options.

    Args:
        error: an error.
        names: what stands for each option, without dashes.
    """

    def name(found: re.Match[str]) -> str:
        return f"{names[found[1]]} " if found[1] in names else found[0]

    words = _VALUE.sub(name, str(error))
    return error if words == str(error) else type(error)(words, error.setting)


def _configured(ctx: click.Context | None, param: click.Parameter) -> bool:
    """Whether a parameter has its value from the file."""
    return ctx is not None and ctx.get_parameter_source(str(param.name)) is ParameterSource.DEFAULT_MAP


def place(setting: str, folder: Path | None = None) -> str:
    """Where a setting of `folder` is, for messages; without a folder, of the working directory."""
    path, _ = settings(folder or Path.cwd())
    return f"{path}: [tool.envcraft] {setting}"


def configuration(
    folder: Path,
    options: dict[str, str],
    repeated: Collection[str] = (),
    others: Callable[[], Collection[str]] = frozenset,
) -> dict[str, Any]:
    """Read ``[tool.envcraft]`` of the ``pyproject.toml`` in `folder`, or of the nearest one above.

    Args:
        folder: where the search for the file starts.
        options: the allowed settings, each with the parameter that it sets.
        repeated: parameters that take a list; for the others, a list is joined by commas, and a table becomes JSON.
        others: gives the settings of other commands, which are ignored.

    Returns:
        Values by parameter, for Click's ``default_map``.

    Raises:
        UsageError: the file is malformed, a setting does not exist, or a list holds something other than strings.
    """
    path, table = settings(folder)
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key == "contracts" and not isinstance(value, dict):
            raise UsageError(f"{path}: [tool.envcraft.contracts] must hold a table for each contract")
        if key == "corpus" and not isinstance(value, str):
            raise UsageError(f"{path}: [tool.envcraft] corpus must be the path of a corpus, not {value!r}")
        if key in ("contracts", "corpus", "llm", "severity"):
            continue
        name = key.replace("_", "-")
        if name not in options and name in others():
            continue
        if name not in options:
            known = dict.fromkeys([*options, *sorted(others())])
            raise UsageError(f"{path}: [tool.envcraft] has no setting {did_you_mean(key, known)}")
        if (value == "" or (isinstance(value, list) and "" in value)) and name not in TURNED_OFF:
            raise UsageError(f"{path}: [tool.envcraft] {key} is empty; give a value, or leave it out")
        beside = path.parent / str(value)
        # A policy may be the name of a player.
        if path.parent != Path.cwd() and (name == "baseline" or (name == "policy" and beside.is_file())):
            values[options[name]] = str(beside)
        elif isinstance(value, dict):
            values[options[name]] = json.dumps(value, default=str)
        elif options[name] in repeated:
            values[options[name]] = listed = value if isinstance(value, list) else [value]
            for wrong in (each for each in listed if not isinstance(each, str)):
                raise UsageError(f"{path}: [tool.envcraft] {key}: {wrong!r} is not a string")
        else:
            values[options[name]] = ",".join(map(str, value)) if isinstance(value, list) else value
    return values
