"""Look up what plugins offer, by hook and by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import click

from envcraft.errors import UsageError
from envcraft.plugins import plugins

_warned: set[str] = set()
#: The most names that a message lists.
_FEW = 20
#: The similarity, from 0 to 1, from which one name is a misspelling of another.
_SAME = 0.9


def offered(hook: str) -> list[Any]:
    """Collect the objects that plugins offer for a hook, and warn once on stderr about each broken plugin."""
    objects = plugins().collect(hook)
    _warn()
    return objects


def named(hook: str, name: str) -> Any | None:
    """Find one object by its name, or None. Unlike :func:`offered`, this imports no plugin that comes after it."""
    item = plugins().find(hook, name)
    _warn()
    return item


def lookup(kind: str, name: str, known: Mapping[str, Any]) -> Any:
    """Return the value of a name.

    Args:
        kind: what the names stand for, for the message: ``contract``.
        name: the name that a user gave.
        known: the values by name.

    Raises:
        UsageError: the name does not exist; the message suggests the nearest one.
    """
    if name not in known:
        raise UsageError(f"there is no {kind} {did_you_mean(str(name), known)}", setting=kind)
    return known[name]


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Describe an unknown name: the name with a known one that hardly differs, else with those that begin with it,
    else with the nearest, else with all if these are few, else with some.
    """
    # Slow to import, and needed only for an error.
    import difflib

    known = list(known)
    # The letter O for a zero, as in a code.
    digits = name.upper().replace("O", "0").removeprefix("EC")
    if digits.isdecimal() and f"EC{digits}" in known:
        return f"{name!r}; did you mean EC{digits}?"
    longer = [other for other in known if name and other.lower().startswith(name.lower())]
    several = 1 < len(longer) <= _FEW
    cutoff = _SAME if several else 0.6
    near = difflib.get_close_matches(name.lower(), [other.lower() for other in known], n=1, cutoff=cutoff)
    if several and not near:
        return f"{name!r}; did you mean {', '.join(longer[:-1])} or {longer[-1]}?"
    if len(longer) == 1 and not near:
        return f"{name!r}; did you mean {longer[0]}?"
    if near:
        return f"{name!r}; did you mean {next(other for other in known if other.lower() == near[0])}?"
    if len(known) > _FEW:
        return f"{name!r}; there are {len(known)}, such as {', '.join(known[:3])}"
    return f"{name!r}; choose from {', '.join(known)}" if known else repr(name)


def _warn() -> None:
    for broken in plugins().broken:
        line = f"Warning: ignored the broken plugin {broken.plugin}: {broken.error}"
        if line not in _warned:
            _warned.add(line)
            click.echo(" ".join(line.split()), err=True)
