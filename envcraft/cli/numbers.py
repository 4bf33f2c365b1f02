"""What a number on the command line must be, in words."""

from __future__ import annotations

import re

import click

_REFUSED = re.compile(r"(.+) is not (?:a valid (?:integer|float)|in the range)\b.*", re.DOTALL)


def explained(error: click.BadParameter) -> str:
    """The message of an error; where a number is refused, with what is expected instead of the name of a type."""
    kind, found = error.param.type if error.param is not None else None, _REFUSED.fullmatch(error.message)
    whole = isinstance(kind, click.types.IntParamType)
    if found is None or not (whole or isinstance(kind, click.types.FloatParamType)):
        return error.message
    limits = _limits(kind) if isinstance(kind, click.IntRange | click.FloatRange) else ""
    return f"{found[1]} is not a {'whole ' if whole else ''}number{limits}"


def _limits(kind: click.IntRange | click.FloatRange) -> str:
    least, most = kind.min, kind.max
    if least is not None and most is not None and not (kind.min_open or kind.max_open):
        return f" from {least} to {most}"
    lower = [f"{'above' if kind.min_open else 'of at least'} {least}"] if least is not None else []
    upper = [f"{'below' if kind.max_open else 'of at most'} {most}"] if most is not None else []
    return f" {' and '.join(lower + upper)}" if lower + upper else ""
