"""Register the three built-in drivers and the commands ``doctor`` and ``sandbox``."""

from __future__ import annotations

import click

from envcraft.judging.driver import Driver
from envcraft.plugins import hookimpl


@hookimpl
def envcraft_sandbox_drivers() -> list[Driver]:
    from .bubblewrap import BubblewrapDriver
    from .docker import DockerDriver
    from .process import ProcessDriver

    return [DockerDriver(), BubblewrapDriver(), ProcessDriver()]


@hookimpl
def envcraft_commands() -> list[click.Command]:
    from .commands import doctor, sandbox

    return [doctor, sandbox]
