"""The commands of the framework itself: a plugin like any other, one file a command."""

from __future__ import annotations

from collections.abc import Iterator

import click

from envcraft.plugins import hookimpl


@hookimpl
def envcraft_commands() -> Iterator[click.Command]:
    # The one that people wait for comes without the others' imports.
    from envcraft.cli.commands.validate import validate

    yield validate

    from envcraft.cli.commands.audit import audit
    from envcraft.cli.commands.corpus_group import corpus
    from envcraft.cli.commands.explain import explain
    from envcraft.cli.commands.export import export
    from envcraft.cli.commands.generate import generate
    from envcraft.cli.commands.listings import checks, contracts, plugins
    from envcraft.cli.commands.new import new
    from envcraft.cli.commands.play import play
    from envcraft.cli.commands.replay import replay
    from envcraft.cli.commands.reverify import reverify

    yield from [new, generate, play, audit, corpus, reverify, export, replay, explain, checks, contracts, plugins]
