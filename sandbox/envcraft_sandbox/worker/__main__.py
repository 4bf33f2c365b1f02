"""``python -m envcraft_sandbox.worker --fd N`` or ``--connect PATH``: serve jobs until the host hangs up."""

from __future__ import annotations

import argparse
import socket

from .server import serve


def main() -> None:
    parser = argparse.ArgumentParser(prog="envcraft-worker", description=__doc__)
    parser.add_argument("--fd", type=int, help="an inherited, connected stream socket")
    parser.add_argument("--connect", metavar="PATH", help="a unix socket to connect to")
    options = parser.parse_args()
    if options.connect is not None:
        control = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        control.connect(options.connect)
    else:
        control = socket.socket(fileno=options.fd)
    serve(control)


if __name__ == "__main__":
    main()
