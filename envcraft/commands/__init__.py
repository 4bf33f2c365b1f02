"""The commands of the framework itself: a plugin like any other, one file a command."""

from __future__ import annotations

from collections.abc import Iterator

import click

from envcraft.plugins import hookimpl


@hookimpl
def envcraft_commands() -> Iterator[click.Command]:
    # The one that people wait for comes without the others' imports.
    from .validate import validate

    yield validate

    from .audit import audit
    from .corpus import corpus
    from .explain import explain
    from .export import export
    from .generate import generate
    from .listings import checks, contracts, plugins
    from .new import new
    from .play import play
    from .replay import replay
    from .reverify import reverify

    yield from [new, generate, play, audit, corpus, reverify, export, replay, explain, checks, contracts, plugins]
