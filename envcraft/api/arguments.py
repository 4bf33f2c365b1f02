"""The arguments of calls from Python, whose types no command line has checked."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import click

from envcraft.cli.configured import TURNED_OFF
from envcraft.errors import UsageError

#: The parameters of the command whose values are lists that commas separate.
_LISTS = {"checks", "skip", "select", "ignore"}


def require_values(given: Mapping[str, Any], parameters: Collection[click.Parameter], words: Mapping[str, str]) -> None:
    """Check the arguments of a call.

    Args:
        given: The arguments, by parameter of the command.
        parameters: Those of the command.
        words: The names of the arguments.

    Raises:
        UsageError: A value is empty, of another type than the command's, or none of its values.
    """
    options = {each.name: each for each in parameters if isinstance(each, click.Option)}
    for name, value in given.items():
        # The arguments of the constructor may be any.
        if name == "kwargs":
            continue
        if name not in TURNED_OFF and (value == "" or (isinstance(value, list | tuple) and "" in value)):
            raise UsageError(f"{words[name]} is {value!r}; give a value, or leave it out")
        if wanted := _wanted(options[name], value):
            raise UsageError(f"{words[name]} is {value!r}; it must be {wanted}")


def require_flags(given: Mapping[str, Any]) -> None:
    """Raise UsageError, with its name, if an argument is neither True nor False."""
    for name, value in given.items():
        if not isinstance(value, bool):
            raise UsageError(f"{name} is {value!r}; it must be True or False")


def _wanted(option: click.Option, value: Any) -> str:
    """What an option takes instead of a value; "" if it takes the value."""
    kind = option.type
    if option.is_flag:
        return "" if isinstance(value, bool) else "True or False"
    if isinstance(kind, click.IntRange | click.FloatRange):
        return _range(kind, value)
    if isinstance(kind, click.Choice):
        *names, last = kind.choices
        return "" if value in kind.choices else f"{', '.join(names)} or {last}"
    if isinstance(value, str):
        return ""
    if option.name not in _LISTS and not option.multiple:
        return "a string"
    listed = isinstance(value, Collection) and not isinstance(value, bytes | Mapping)
    return "" if listed and all(isinstance(each, str) for each in value) else "a string or a list of strings"


def _range(kind: click.IntRange | click.FloatRange, value: Any) -> str:
    whole, least, most = isinstance(kind, click.IntRange), kind.min or 0, math.inf if kind.max is None else kind.max
    fits = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
    if fits and (least < value if kind.min_open else least <= value) and value <= most and value < math.inf:
        return ""
    limits = (
        f"above {least}" if kind.min_open else f"of {least} or more" if most == math.inf else f"from {least} to {most}"
    )
    return f"{'a whole number' if whole else 'a number'} {limits}"
