"""The command ``envcraft``, also as ``python -m envcraft``."""

from __future__ import annotations

import gc
import sys

#: How many objects may be allocated before a search for cycles of garbage. By default the imports alone start a hundred
#: searches, 5% of their instructions.
_ALLOCATED = 50_000
# During imports at module level, Ctrl-C would print a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType


def main() -> None:
    """Run the command line."""
    gc.set_threshold(_ALLOCATED, 20, 20)
    try:
        _run()
    except KeyboardInterrupt:
        # The interrupt came before the command line could handle it.
        sys.stderr.write("interrupted\n")
        sys.exit(130)
    finally:
        # The interpreter would search all objects again at its end, 8% of the instructions of the imports.
        gc.freeze()


def _run() -> None:
    import io
    import os
    import signal

    # NumPy's BLAS starts a thread for each core, which spins for 30 ms. No command multiplies large matrices in NumPy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from envcraft.cli.group import cli

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Text of an environment may not fit the terminal's encoding.
            stream.reconfigure(errors="backslashreplace")
    if not os.environ.get("FORCE_COLOR", "unset"):
        # Rich would take an empty value for a request for no colours.
        del os.environ["FORCE_COLOR"]
    # SIGTERM acts like Ctrl-C, so that the workers are closed.
    signal.signal(signal.SIGTERM, _interrupt)
    cli(prog_name="envcraft")


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
