"""``python -m envcraft_sandbox.worker --fd N`` or ``--connect PATH``: serve jobs until the host hangs up.

``--fd`` is an inherited, connected stream socket, and ``--connect`` a unix socket to connect to. Jobs write to
``--folder``, and read each ``--read`` besides the libraries. ``--zygote SIZE`` forks fork servers instead, in
namespaces of their own with a file system of SIZE bytes; 0 means neither. Only drivers write this command line, and the
import of a parser would take as long as the start of Python.
"""

from __future__ import annotations

import gc
import os
import sys


def main() -> None:
    _put_the_standard_library_first()
    import socket

    words = list(zip(sys.argv[1::2], sys.argv[2::2], strict=True))
    options = dict(words)
    # As in an interactive interpreter: a module that parses the command line when it is imported finds none.
    sys.argv[:] = [""]
    if "--connect" in options:
        control = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        control.connect(options["--connect"])
    else:
        control = socket.socket(fileno=int(options["--fd"]))
    # The imports create no garbage.
    gc.disable()
    read = [path for name, path in words if name == "--read"]
    if "--zygote" in options:
        from . import zygote

        zygote.run(control, read, int(options["--zygote"]) or None)
        return
    from .server import serve

    serve(control, options.get("--folder", "/tmp/job"), read)


def _put_the_standard_library_first() -> None:
    """Move the standard library to the front of ``sys.path``, because PYTHONPATH puts the libraries before it.

    A library may have the name of a standard module, such as ``pathlib``, which was made for Python 2.
    """
    standard = os.path.dirname(os.__file__)
    sys.path.sort(key=lambda entry: entry != standard)


if __name__ == "__main__":
    main()
