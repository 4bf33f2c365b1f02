"""The command ``envcraft``, also as ``python -m envcraft``."""

from __future__ import annotations

import signal
from types import FrameType


def main() -> None:
    """Run the command line."""
    from envcraft.cli import cli

    # Ending politely is the same as Ctrl-C: the workers are closed on the way out.
    signal.signal(signal.SIGTERM, _interrupt)
    cli(prog_name="envcraft")


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
