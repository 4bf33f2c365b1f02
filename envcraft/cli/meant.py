"""The option that stands for one that a command does not have."""

from __future__ import annotations

import click

#: Options of other tools, with what does the same here.
_ELSEWHERE = {
    "-j": "--workers",
    "-n": "--workers",
    "--jobs": "--workers",
    "--numprocesses": "--workers",
    "--timeout": "--time-limit",
    "--steps": "--budget",
    "--episodes": "--budget",
    "--maxfail": "--exitfirst",
    "--disable": "--ignore",
    "--enable": "--select",
    "--fail-on": "--strict",
    "--junitxml": "--report junit:FILE",
    "--junit-xml": "--report junit:FILE",
}


def with_the_option_meant(error: click.NoSuchOption) -> click.UsageError:
    """Replace Click's suggestions, which are names of a similar spelling, if an option does what a name says.

    ``--json`` is ``--format json``, ``-o`` is ``--output``, and ``--jobs`` is ``--workers``.

    Args:
        error: the error about the name; its context is that of the command.

    Returns:
        An error with better suggestions, or the same one if there are none.
    """
    if error.ctx is None or not (meant := _meant(error.ctx, error.option_name)):
        return error
    *others, last = meant
    names = f"{', '.join(others)} or {last}" if others else last
    return click.UsageError(f"{error.message} Did you mean {names}?", error.ctx)


def _meant(ctx: click.Context, name: str) -> list[str]:
    options = [param for param in ctx.command.params if isinstance(param, click.Option)]
    names = [next(spelled for spelled in option.opts if spelled.startswith("--")) for option in options]
    same = _ELSEWHERE.get(name)
    if same and same.split()[0] in names:
        return [same]
    if not name.startswith("--"):
        return [spelled for spelled in names if spelled[2] == name[1]]
    values = [
        f"{option.opts[0]} {item.value}"
        for option in options
        for item in option.shell_complete(ctx, name[2:])
        if item.type == "plain" and item.value == name[2:]
    ]
    return values[:1] or [spelled for spelled in names if spelled.startswith(name)]
