"""Hook implementations: commands, generators, stages, and the exporter of data for fine-tuning."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.corpus.export.exporter import Exporter
    from envcraft.generation.generators import Generator
    from envcraft.generation.stages import Stage


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
