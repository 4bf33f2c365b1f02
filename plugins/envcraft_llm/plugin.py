"""Hook implementations: commands, generators, stages, pools, and the exporter of data for fine-tuning."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.corpus.export.exporter import Exporter
    from envcraft.generation.generators import Generator
    from envcraft.generation.stages import Stage
    from envcraft.model.pool import Pool


@hookimpl
def envcraft_commands() -> list[click.Command]:
    from .concepts.command import concepts
    from .pipeline.single import privileged, repair

    return [concepts, repair, privileged]


@hookimpl
def envcraft_generators() -> list[Generator]:
    from envcraft.generation.generators import Generator

    from .pipeline.command import merge, pipeline

    return [Generator(pipeline, frozenset({"concepts", "model", "base_url"}), merge)]


@hookimpl
def envcraft_stages() -> list[Stage]:
    from .stages import OPTIONAL, STAGES

    return [stage() for stage in (*STAGES, *OPTIONAL)]


@hookimpl
def envcraft_exporters() -> list[Exporter]:
    from .sft.exporter import SftExporter

    return [SftExporter()]


@hookimpl
def envcraft_pools() -> list[Pool]:
    from envcraft.model.pool import Pool

    from .concepts.generation import KINDS
    from .concepts.pools import pools

    return [Pool(kind, tuple(getattr(pools(), name))) for name, kind in KINDS.items()]
