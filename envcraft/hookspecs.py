"""Every hook of EnvCraft, in the order in which a run comes to them.

A plugin is a module or object with functions marked ``@envcraft.plugins.hookimpl``; a package offers one through the
entry-point group ``envcraft``. Each hook gives a list of objects, and each object is run guarded, so that a plugin that
breaks is named and the others go on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pluggy

if TYPE_CHECKING:
    from collections.abc import Iterable

    import click

    from envcraft.check import Check
    from envcraft.contract import Contract
    from envcraft.corpus.export import Exporter
    from envcraft.demonstrations.player import Player
    from envcraft.executors import ExecutorPlugin
    from envcraft.families import Family
    from envcraft.generators import Generator
    from envcraft.reports import Reporter
    from envcraft.sandbox import Driver
    from envcraft.stages import Stage

hookspec = pluggy.HookspecMarker("envcraft")


@hookspec
def envcraft_commands() -> Iterable[click.Command]:
    """Commands for the command line. Called in most runs of ``envcraft``: import heavy libraries in the command."""


@hookspec
def envcraft_contracts() -> list[Contract]:
    """Contracts that ``--contract`` can name."""


@hookspec
def envcraft_sandbox_drivers() -> list[Driver]:
    """Ways to isolate workers. Making a driver must not start anything."""


@hookspec
def envcraft_checks() -> list[Check]:
    """Rules that judge a subject. They run in the order of registration, those that always run last."""


@hookspec
def envcraft_reporters() -> list[type[Reporter]]:
    """Formats that ``--format`` can name."""


@hookspec
def envcraft_executors() -> list[ExecutorPlugin]:
    """Where else ``envcraft audit --executor`` can judge. Making one starts nothing, and imports no library."""


@hookspec
def envcraft_families() -> list[Family]:
    """Environments that a program writes, for ``envcraft generate --family`` to name."""


@hookspec
def envcraft_generators() -> list[Generator]:
    """Other ways for ``envcraft generate`` to write environments, each with options of its own."""


@hookspec
def envcraft_stages() -> list[Stage]:
    """Steps on the way from a concept to an environment: further ones, or ones in the place of others."""


@hookspec
def envcraft_players() -> list[Player]:
    """Who plays for demonstrations, for ``envcraft demos --player`` to name."""


@hookspec
def envcraft_exporters() -> list[Exporter]:
    """What ``envcraft export --to`` can make of a corpus."""
