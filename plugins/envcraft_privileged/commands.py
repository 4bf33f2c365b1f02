"""``envcraft demos``: records players in the environments of a corpus."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from envcraft.cli import completion
from envcraft.cli.configured import Configured
from envcraft.cli.options import sandbox_options
from envcraft.cli.signals import uninterrupted
from envcraft.contracts.lookup import contract_named
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.judging.driver import Driver, ensure
from envcraft.judging.selection import driver_named
from envcraft.model.target import read_policy
from envcraft.model.verdict import Verdict
from envcraft.registry import did_you_mean, offered
from envcraft.text import one_line, plural

if TYPE_CHECKING:
    from envcraft.corpus.store import Environment, Store
    from envcraft.corpus.store.demonstrations import Row
    from envcraft.demonstrations import recorder
    from envcraft.demonstrations.player import Player
    from envcraft.model.contract import Contract

#: The player for environments of no family, and the contract of environments that have passed under none.
_DEFAULT_PLAYER, _CONTRACT = "search", "arcade"


class _Players(Configured):
    """A command whose help lists the players of all plugins."""

    # The setting of this name selects rules.
    apart = frozenset({"select"})

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        with formatter.section("Players"):
            formatter.write_dl(
                [(player.name, player.summary) for player in offered("envcraft_players")]
                + [(f"{loader.name}:PATH", loader.summary) for loader in offered("envcraft_player_loaders")]
            )


@click.command(cls=_Players)
@click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
@click.option(
    "--steps",
    type=click.IntRange(1),
    default=10_000,
    show_default=True,
    help="Record this many transitions in each environment.",
)
@click.option(
    "--player",
    "name",
    metavar="NAME",
    show_default=f"the player of the environment's family, else {_DEFAULT_PLAYER}",
    help="Record this player, from the list below.",
)
@click.option(
    "--policy",
    metavar="FILE",
    shell_complete=completion.files,
    help="Record the privileged policy in this file: act(state) or policy(env).",
)
@click.option("--select", metavar="GLOB", help="Play only environments whose name matches, like 'tetris_0_00*'.")
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    default=0,
    show_default=True,
    help="Derive the episodes from this seed.",
)
@click.option(
    "--contract",
    "promise",
    metavar="NAME",
    shell_complete=completion.contracts,
    show_default=f"the contract that each has passed, else {_CONTRACT}",
    help="Play the environments under this contract.",
)
@click.option("--cache", is_flag=True, help="Also write the frame caches that are missing, for training.")
@click.option("--verify", is_flag=True, help="Play all recordings again and report differences; record nothing.")
@sandbox_options()
@click.pass_context
def demos(
    ctx: click.Context,
    corpus: Path,
    steps: int,
    name: str | None,
    policy: str | None,
    select: str | None,
    seed: int,
    promise: str | None,
    cache: bool,
    verify: bool,
    sandbox: str,
    runtime: str | None,
    require_isolation: str | None,
    workers: int | None,
) -> None:
    """Record a player in each environment of a corpus.

    Environments that have a recording are skipped, so an interrupted run continues when it is started again. A policy
    runs in the sandbox beside the environment and must not change it.

    \b
    Exit status: 0 all recordings are made, or reproduced
                 1 a policy fails, or a recording differs
                 2 usage error
                 3 an environment could not be played
    """
    if name is not None and policy is not None:
        raise UsageError(f"--player {name} and --policy {policy} exclude each other")
    players = _players(name, policy)
    promised = contract_named(promise) if promise is not None else None
    with contextlib.ExitStack() as stack:
        driver = driver_named(sandbox, require_isolation, runtime, probe=False)
        stack.callback(driver.close)
        with uninterrupted():
            from envcraft.corpus.store import Store
            from envcraft.demonstrations import cache as frames
        if cache:
            frames.ensure_zstandard()
        ensure(driver)
        store = stack.enter_context(Store(corpus, write=True))
        status = _ExitStatus()
        try:
            if not verify:
                _record(store, players, promised, driver, steps, seed, select, workers, status)
            if verify or cache:
                _replay(store, name, promised, driver, verify, select, workers, status)
        except OSError as error:
            raise EnvCraftError(f"{error.filename or corpus} cannot be written: {error.strerror or error}") from None
    ctx.exit(status.code)


class _ExitStatus:
    """Reports failures, and remembers the worst."""

    def __init__(self) -> None:
        self.code = ExitCode.PASS

    def add(self, result: recorder.RunResult) -> None:
        """Print a line for each environment that failed."""
        for report in result.failed:
            findings = [finding for check in report.checks for finding in check.findings]
            reasons = [check.reason for check in report.checks if check.reason]
            words = "; ".join(f"{finding.code} {finding.message}" for finding in findings) or "; ".join(reasons)
            click.echo(f"{one_line(report.path)}: {one_line(words or report.reason or 'it could not be played')}")
            if report.verdict is Verdict.FAIL:
                self.code = ExitCode.FAIL
            elif self.code is ExitCode.PASS:
                self.code = ExitCode.ERROR


def _players(name: str | None, policy: str | None) -> list[Player]:
    """The players; the first that can play an environment plays it. Raises UsageError."""
    from envcraft.demonstrations.player import PolicyPlayer, loaded_player

    if policy is not None:
        return [PolicyPlayer(read_policy(policy))]
    known = {player.name: player for player in offered("envcraft_players")}
    if name is None:
        return [*(player for player in known.values() if player.families), known[_DEFAULT_PLAYER]]
    if name not in known:
        if ":" in name:
            return [loaded_player(name)]
        raise UsageError(f"there is no player {did_you_mean(name, known)}")
    return [known[name]]


def _record(
    store: Store,
    players: list[Player],
    promised: Contract | None,
    driver: Driver,
    steps: int,
    seed: int,
    select: str | None,
    workers: int | None,
    status: _ExitStatus,
) -> None:
    from envcraft.demonstrations import recorder
    from envcraft.demonstrations.store import prune

    prune(store)
    groups: dict[tuple[str, str], list[Environment]] = {}
    unplayable = 0
    for environment, family in _environments(store, select):
        player = next((player for player in players if player.plays(family)), None)
        if player is None:
            unplayable += 1
        else:
            contract = promised.name if promised is not None else _contract(store, environment)
            groups.setdefault((player.name, contract), []).append(environment)
    if unplayable:
        words = " and ".join(player.name for player in players)
        click.echo(f"skipped {plural(unplayable, 'environment')} whose family {words} cannot play", err=True)
    known = {player.name: player for player in players}
    for (name, contract), chosen in groups.items():
        under = contract_named(contract)
        with _progress() as on_event:
            result = recorder.record(store, chosen, known[name], under, driver, steps, seed, workers, on_event)
        status.add(result)
        before = len(chosen) - result.done - len(result.failed)
        words = name if contract == _CONTRACT else f"{name}, {contract}"
        click.echo(
            f"{words}: recorded {plural(result.steps, 'step')} in {plural(result.done, 'environment')}, "
            f"{before:,} already recorded"
        )


def _contract(store: Store, environment: Environment) -> str:
    """The contract under which an environment has passed, else the default one."""
    from envcraft.corpus.trust import contract_of, last_verdicts

    return contract_of(last_verdicts(store, environment.source, environment.env_class)) or _CONTRACT


def _replay(
    store: Store,
    name: str | None,
    promised: Contract | None,
    driver: Driver,
    verify: bool,
    select: str | None,
    workers: int | None,
    status: _ExitStatus,
) -> None:
    from envcraft.corpus.store import demonstrations
    from envcraft.demonstrations import recorder

    wanted = {environment.source for environment, _ in _environments(store, select)}
    groups: dict[str, list[tuple[str, Row]]] = {}
    for one, row in demonstrations.named(store, name):
        if row.source in wanted and (promised is None or row.contract == promised.name):
            groups.setdefault(row.contract, []).append((one, row))
    if not groups:
        raise UsageError(f"{store.root} has no such recording; `envcraft demos {store.root}` makes recordings")
    count = failed = 0
    for contract, named in groups.items():
        with _progress() as on_event:
            result = recorder.replay(store, named, contract_named(contract), driver, not verify, workers, on_event)
        status.add(result)
        count, failed = count + len(named), failed + len(result.failed)
    words = "" if verify else " for the cache"
    click.echo(f"played {plural(count, 'recording')} again{words}; {plural(failed, 'environment')} failed")


def _environments(store: Store, select: str | None) -> Iterator[tuple[Environment, str | None]]:
    """One environment for each source, with its family if it has one. Raises UsageError if there is none."""
    from envcraft.corpus.store import environments

    rows = environments.distinct(store, select)
    if not rows and select:
        rows = environments.distinct(store, f"{select}.py")
    if not rows:
        words = f"no environment called {select}" if select else "no environment"
        raise UsageError(f"{store.root} has {words}; `envcraft corpus list {store.root}` lists the environments")
    for row in rows:
        yield row.environment, row.origin.get("family")


@contextlib.contextmanager
def _progress() -> Iterator[recorder.EventHandler]:
    """Show the progress on standard error."""
    import io

    from envcraft.cli.progress import Progress

    with Progress(io.StringIO(), verb="played") as progress:
        try:
            yield progress.handle
        except KeyboardInterrupt:
            click.echo("interrupted; the same command continues the recording", err=True)
            raise
