"""The commands of the framework itself: a plugin like any other, one file a command."""

from __future__ import annotations

import click

from envcraft.plugins import hookimpl


@hookimpl
def envcraft_commands() -> list[click.Command]:
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
    from .validate import validate

    return [new, generate, play, validate, audit, corpus, reverify, export, replay, explain, checks, contracts, plugins]
