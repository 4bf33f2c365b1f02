"""Dask loads this module in each worker process that EnvCraft starts."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Ignore Ctrl-C, which a terminal sends to all processes: the auditing process ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
