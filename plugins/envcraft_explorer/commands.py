"""``envcraft explore``."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import tempfile
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

import click

from envcraft.cli import completion
from envcraft.cli.options import runtime_option
from envcraft.cli.signals import uninterrupted
from envcraft.errors import UsageError
from envcraft.judging.selection import driver_named

if TYPE_CHECKING:
    from envcraft.corpus.report.results import ResultRow
    from envcraft.demonstrations.player import Player
    from envcraft.judging.driver import Driver
    from envcraft_explorer.stage import Stage

_REQUIRED = ("jinja2", "matplotlib", "starlette", "uvicorn", "websockets")
_HOST = "127.0.0.1"


@click.command()
@click.argument("corpus", metavar="CORPUS|FOLDER", type=click.Path(path_type=Path))
@click.option(
    "--export",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Write the pages as static files into this folder, and serve nothing.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65_535),
    default=0,
    show_default="a free one",
    help="Port on the loopback interface.",
)
@click.option("--open/--no-open", "show", default=True, show_default=True, help="Open the page in a browser.")
@click.option(
    "--previews/--no-previews",
    default=True,
    show_default=True,
    help="Play one short episode of each environment that has no preview yet.",
)
@click.option(
    "--episodes/--no-episodes",
    default=True,
    show_default=True,
    help="With --export, record episodes of players and of findings.",
)
@click.option(
    "--player",
    "chosen",
    metavar="checkpoint:PATH",
    multiple=True,
    help="Let a policy of `envcraft train` play, too. Can be repeated.",
)
@click.option(
    "--results",
    metavar="FILE",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Show results that `envcraft evaluate --output` wrote. Can be repeated; the first is the baseline.",
)
@click.option(
    "--sandbox",
    default="auto",
    show_default=True,
    metavar="NAME",
    shell_complete=completion.sandboxes,
    help="The sandbox that runs the environments.",
)
@runtime_option
def explore(
    corpus: Path,
    export: Path | None,
    port: int,
    show: bool,
    previews: bool,
    episodes: bool,
    chosen: tuple[str, ...],
    results: tuple[Path, ...],
    sandbox: str,
    runtime: str | None,
) -> None:
    """Explore a corpus in the browser and play its environments.

    The server accepts only connections from this machine, with the token in the address that the command prints. The
    environments run in the sandbox. Ctrl-C stops the server.
    """
    for name in _REQUIRED:
        if importlib.util.find_spec(name) is None:
            raise UsageError(f"the explorer needs {name}: `pip install 'envcraft-rl[explore]'`")
    from envcraft.corpus.report.results import result_rows

    rows = result_rows(results)
    players = _loaded(chosen)
    with contextlib.closing(driver_named(sandbox, runtime=runtime)) as driver:
        if export is not None:
            _export(corpus, export, driver, previews, rows, players, episodes)
        else:
            _serve(corpus, driver, port, show, previews, rows, players)


def _loaded(names: tuple[str, ...]) -> list[Player]:
    """Raises UsageError."""
    if not names:
        return []
    from envcraft.demonstrations.player import loaded_player

    return [loaded_player(name) for name in names]


def _export(
    corpus: Path,
    output: Path,
    driver: Driver,
    previews: bool,
    results: list[ResultRow],
    players: list[Player],
    episodes: bool,
) -> None:
    from envcraft.corpus.report.write import check_requirements

    check_requirements(output)
    _write(corpus, output, driver, previews, results, players, episodes)
    click.echo(output / "index.html")


def _serve(
    corpus: Path,
    driver: Driver,
    port: int,
    show: bool,
    previews: bool,
    results: list[ResultRow],
    players: list[Player],
) -> None:
    with uninterrupted():
        import uvicorn

        from envcraft_explorer.server import Server
    with contextlib.ExitStack() as stack:
        listening = stack.enter_context(_listen(port))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="envcraft-explorer-"))) / "site"
        stage = _write(corpus, folder, driver, previews, results, players)
        port = listening.getsockname()[1]
        server = Server(folder, stage, port)
        stack.callback(server.close)
        address = f"http://{_HOST}:{port}/?token={server.token}"
        click.echo(address)
        if show:
            webbrowser.open(address)
        config = uvicorn.Config(
            server.app, log_level="warning", lifespan="off", ws_max_size=64 * 1024, timeout_graceful_shutdown=2
        )
        uvicorn.Server(config).run([listening])


def _write(
    corpus: Path,
    output: Path,
    driver: Driver,
    previews: bool,
    results: list[ResultRow],
    players: list[Player],
    episodes: bool | None = None,
) -> Stage:
    """Write the pages, and return the environments to play. With `episodes` None, the pages are those of a server."""
    with uninterrupted():
        from envcraft.corpus.report.write import default_contract, followed_folder, write_report
        from envcraft.corpus.store import open_store
        from envcraft_explorer.export import record_all
        from envcraft_explorer.stage import Stage
    with contextlib.ExitStack() as stack:
        store = stack.enter_context(open_store(corpus))
        files, contract = followed_folder(store), default_contract(store)
        if previews and not store.writes:
            _say("Another process writes to the corpus, so missing previews are not made.")
        player = driver if previews and store.writes else None
        stage = Stage(store.root, files, driver, contract.name, chosen=players)
        recorded = None
        if episodes:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="envcraft-explorer-")))
            recorded = record_all(stage, folder, _say)
        live = episodes is None
        write_report(
            store, output, files, contract, player, message=_say, live=live, episodes=recorded, results=results
        )
        return stage


def _listen(port: int) -> socket.socket:
    """Listen on the loopback interface. Raises UsageError."""
    try:
        return socket.create_server((_HOST, port))
    except OSError as error:
        raise UsageError(
            f"--port {port} cannot be used: {error.strerror or error}; leave it out for a free one"
        ) from None


def _say(text: str) -> None:
    click.echo(text, err=True)
