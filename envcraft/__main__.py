"""The command ``envcraft``, also as ``python -m envcraft``."""

from __future__ import annotations

import sys

# Whatever is imported out here takes time in which Ctrl-C is a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType


def main() -> None:
    """Run the command line."""
    try:
        _run()
    except KeyboardInterrupt:
        # Where it comes before the command line is there to say so.
        sys.stderr.write("interrupted\n")
        sys.exit(130)


def _run() -> None:
    import io
    import signal

    from envcraft.cli import cli

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # What an environment says may not fit the terminal's encoding, and that is no reason to stop.
            stream.reconfigure(errors="backslashreplace")
    # Ending politely is the same as Ctrl-C: the workers are closed on the way out.
    signal.signal(signal.SIGTERM, _interrupt)
    cli(prog_name="envcraft")


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
