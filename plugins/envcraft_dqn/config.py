"""Options of a command in a TOML file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from envcraft.errors import UsageError
from envcraft_dqn.files import write_atomically

#: Parameters that say where a run is, not what it does.
_PLACES = ("corpus", "output")


def read_config(context: click.Context, parameter: click.Parameter, file: Path | None) -> None:
    """Take the defaults of a command's options from a file.

    Keys are the names of options without their dashes. Values have the types of the options.

    Raises:
        UsageError: The file cannot be read, or has a key that is no option.
    """
    if file is None:
        return
    # `envcraft --help` loads this module.
    import tomllib

    try:
        values: dict[str, Any] = tomllib.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"--config {file} cannot be read: {error}") from None
    known = _options(context.command)
    for key in values:
        if key not in known:
            raise UsageError(f"--config {file} has the key {key!r}, which is not an option of `{context.command_path}`")
    context.default_map = {known[key]: value for key, value in values.items()}


def write_config(file: Path) -> None:
    """Write the options of the running command to a file that :func:`read_config` reads. Raises OSError."""
    context = click.get_current_context()
    lines = []
    for key, name in sorted(_options(context.command).items()):
        value = context.params[name]
        if value is not None:
            # Numbers, flags, strings and lists of strings are the same in JSON and TOML.
            lines.append(f"{key} = {json.dumps(value, default=str, ensure_ascii=False)}\n")
    write_atomically(file, "".join(lines))


def _options(command: click.Command) -> dict[str, str]:
    """The keys of a command's options, and the names of their parameters."""
    options = [one for one in command.params if isinstance(one, click.Option) and one.expose_value]
    return {
        max(one.opts, key=len).removeprefix("--"): one.name
        for one in options
        if one.name is not None and one.name not in _PLACES
    }
