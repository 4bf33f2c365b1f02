"""What Dask loads in each worker process that EnvCraft starts."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the one that audits: it ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
