"""What EnvCraft loads: the entry point of the group ``envcraft`` in pyproject.toml names this module."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
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

# Loaded in every run of the command: each hook imports what it gives when it is called.


@hookimpl
def envcraft_checks() -> list[Check]:
    from .brightness import Brightness

    return [Brightness()]


@hookimpl
def envcraft_contracts() -> list[Contract]:
    from .large import ARCADE_LARGE

    return [ARCADE_LARGE]


@hookimpl
def envcraft_sandbox_drivers() -> list[Driver]:
    from .nice import NiceDriver

    return [NiceDriver()]


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    from .jsonl import JsonLinesReporter

    return [JsonLinesReporter]


@hookimpl
def envcraft_commands() -> list[click.Command]:
    from .census import census

    return [census]


@hookimpl
def envcraft_executors() -> list[ExecutorPlugin]:
    from .processes import ProcessesExecutor

    return [ProcessesExecutor()]


@hookimpl
def envcraft_families() -> list[Family]:
    from .doors import DoorsFamily

    return [DoorsFamily()]


@hookimpl
def envcraft_generators() -> list[Generator]:
    from envcraft.generation.generators import Generator

    from .wicks import wicks

    return [Generator(wicks, frozenset({"wicks"}))]


@hookimpl
def envcraft_stages() -> list[Stage]:
    from .lit import Lit

    return [Lit()]


@hookimpl
def envcraft_pools() -> list[Pool]:
    from envcraft.model.pool import Pool

    return [Pool("wick", ("braided", "paper", "wooden"))]


@hookimpl
def envcraft_players() -> list[Player]:
    from .edge import EdgePlayer

    return [EdgePlayer()]


@hookimpl
def envcraft_player_loaders() -> list[PlayerLoader]:
    from .tape import TapeLoader

    return [TapeLoader()]


@hookimpl
def envcraft_exporters() -> list[Exporter]:
    from .files import FilesExporter

    return [FilesExporter()]
