"""``python -m envcraft_sandbox.worker --fd N`` or ``--connect PATH``: serve jobs until the host hangs up.

``--fd`` is an inherited, connected stream socket, ``--connect`` a unix socket to connect to, ``--folder`` where jobs
may write, each ``--read`` what they may read besides the libraries. With ``--zygote SIZE`` it forks fork servers
instead, in namespaces of their own with so many bytes for files; 0 for neither. Only drivers write this command line,
and importing a parser for it would take as long as Python's own start.
"""

from __future__ import annotations

import gc
import socket
import sys


def main() -> None:
    words = list(zip(sys.argv[1::2], sys.argv[2::2], strict=True))
    options = dict(words)
    if "--connect" in options:
        control = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        control.connect(options["--connect"])
    else:
        control = socket.socket(fileno=int(options["--fd"]))
    # Nothing that the imports make is garbage.
    gc.disable()
    read = [path for name, path in words if name == "--read"]
    if "--zygote" in options:
        from . import zygote

        zygote.run(control, read, int(options["--zygote"]) or None)
        return
    from .server import serve

    serve(control, options.get("--folder", "/tmp/job"), read)


if __name__ == "__main__":
    main()
