"""Every hook of EnvCraft, in the order in which a run calls them.

A plugin is a module or an object with functions marked ``@envcraft.hookimpl``. A package registers one through the
entry-point group ``envcraft``. Each hook returns a list of objects. A plugin that raises is reported by name, and the
others run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pluggy

if TYPE_CHECKING:
    from collections.abc import Iterable

    import click

    from envcraft.corpus.executors import ExecutorPlugin
    from envcraft.corpus.export.exporter import Exporter
    from envcraft.demonstrations.player import Player, PlayerLoader
    from envcraft.environments.families import Family
    from envcraft.generation.generators import Generator
    from envcraft.generation.stages import Stage
    from envcraft.judging.check import Check
    from envcraft.judging.driver import Driver
    from envcraft.model.contract import Contract
    from envcraft.model.pool import Pool
    from envcraft.reports.reporter import Reporter

hookspec = pluggy.HookspecMarker("envcraft")


@hookspec
def envcraft_commands() -> Iterable[click.Command]:
    """Add commands. Most runs of ``envcraft`` call this hook, so import heavy libraries inside the command."""


@hookspec
def envcraft_contracts() -> list[Contract]:
    """Add contracts for ``--contract``."""


@hookspec
def envcraft_sandbox_drivers() -> list[Driver]:
    """Add sandboxes for ``--sandbox``. Constructing a driver must not start anything."""


@hookspec
def envcraft_checks() -> list[Check]:
    """Add checks. They run in the order of registration; gates run first, and checks that always run come last."""


@hookspec
def envcraft_reporters() -> list[type[Reporter]]:
    """Add report formats for ``--format``."""


@hookspec
def envcraft_executors() -> list[ExecutorPlugin]:
    """Add executors for ``envcraft audit --executor``. Constructing one starts nothing and imports no library."""


@hookspec
def envcraft_families() -> list[Family]:
    """Add families of generated environments for ``envcraft generate --family``."""


@hookspec
def envcraft_generators() -> list[Generator]:
    """Add generators, whose options ``envcraft generate`` then has."""


@hookspec
def envcraft_stages() -> list[Stage]:
    """Add stages between a concept and an environment, or replace stages."""


@hookspec
def envcraft_pools() -> list[Pool]:
    """Add pools of ingredients, whose coverage a report on a corpus shows."""


@hookspec
def envcraft_players() -> list[Player]:
    """Add players for ``envcraft demos --player``. With ``advise`` they also label the states of other players."""


@hookspec
def envcraft_player_loaders() -> list[PlayerLoader]:
    """Add kinds of players that come from files, such as trained policies. Constructing a loader imports no library."""


@hookspec
def envcraft_exporters() -> list[Exporter]:
    """Add export formats for ``envcraft export --to``."""
