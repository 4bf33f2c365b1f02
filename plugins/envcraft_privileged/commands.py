"""``envcraft demos``: players play the environments of a corpus, and what they do is kept."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from envcraft.cli import Configured, offered, uninterrupted, unknown
from envcraft.commands.choices import contract_named, driver_named, where_options
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.reports import one_line, plural
from envcraft.sandbox import Driver, ensure
from envcraft.target import read_policy
from envcraft.verdict import Verdict

if TYPE_CHECKING:
    from envcraft.contract import Contract
    from envcraft.corpus.store import Environment, Store
    from envcraft.demonstrations import recording
    from envcraft.demonstrations.player import Player

#: Who plays what no other player was asked for, under which contract where none is known.
_ANY, _CONTRACT = "search", "arcade"


class _Players(Configured):
    """Its help lists the players that the plugins give."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        with formatter.section("Players"):
            formatter.write_dl([(player.name, player.summary) for player in offered("envcraft_players")])


@click.command(cls=_Players)
@click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
@click.option(
    "--steps", type=click.IntRange(1), default=10_000, show_default=True, help="Transitions for each environment."
)
@click.option(
    "--player",
    "name",
    metavar="NAME",
    show_default=f"that of the environment's family, else {_ANY}",
    help="One of the players below.",
)
@click.option("--policy", metavar="FILE", help="A privileged policy that plays: act(state) or policy(env).")
@click.option("--select", metavar="GLOB", help="Only environments with such a name, like 'tetris_0_00*'.")
@click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Same seed, same episodes."
)
@click.option(
    "--contract",
    "promise",
    metavar="NAME",
    show_default=f"the one that each has passed, else {_CONTRACT}",
    help="What the environments promise.",
)
@click.option("--cache", is_flag=True, help="Also keep the frames, for a learner to read; those that are missing.")
@click.option("--verify", is_flag=True, help="Record nothing: play all recordings again, and tell where one differs.")
@where_options()
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
    """Have a player play each environment of a corpus, and record what it does.

    What is recorded already stays. A run that ends in between, however it ends, goes on where it was when it is started
    again. A policy runs in the sandbox, beside the environment, and may change nothing in it.

    \b
    Exit status: 0 all is recorded, or as it was recorded    1 a policy fails, or a recording does not come out again
                 2 wrong use                                 3 something could not be played
    """
    if name is not None and policy is not None:
        raise UsageError(f"either --player {name} or --policy {policy} plays, not both")
    players = _players(name, policy)
    promised = contract_named(promise) if promise is not None else None
    with contextlib.ExitStack() as stack:
        driver = driver_named(sandbox, require_isolation, runtime, probe=False)
        stack.callback(driver.close)
        with uninterrupted():
            from envcraft.corpus.store import Store
            from envcraft.demonstrations import cache as frames
        if cache:
            frames.ensure()
        ensure(driver)
        store = stack.enter_context(Store(corpus, write=True))
        outcome = _Outcome()
        try:
            if not verify:
                _record(store, players, promised, driver, steps, seed, select, workers, outcome)
            if verify or cache:
                _replay(store, name, promised, driver, verify, select, workers, outcome)
        except OSError as error:
            raise EnvCraftError(f"{error.filename or corpus} cannot be written: {error.strerror or error}") from None
    ctx.exit(outcome.exit_code)


class _Outcome:
    """The exit status, by the worst that happened."""

    def __init__(self) -> None:
        self.exit_code = ExitCode.PASS

    def take(self, found: recording.Outcome) -> None:
        """Tell what was wrong, an environment a line."""
        for report in found.bad:
            findings = [finding for check in report.checks for finding in check.findings]
            reasons = [check.reason for check in report.checks if check.reason]
            words = "; ".join(f"{finding.code} {finding.message}" for finding in findings) or "; ".join(reasons)
            click.echo(f"{one_line(report.path)}: {one_line(words or report.reason or 'it could not be played')}")
            if report.verdict is Verdict.FAIL:
                self.exit_code = ExitCode.FAIL
            elif self.exit_code is ExitCode.PASS:
                self.exit_code = ExitCode.ERROR


def _players(name: str | None, policy: str | None) -> list[Player]:
    """Who may play, the first that knows an environment's family before the others. Raises UsageError."""
    from envcraft.demonstrations.player import PolicyPlayer

    if policy is not None:
        return [PolicyPlayer(read_policy(policy))]
    known = {player.name: player for player in offered("envcraft_players")}
    if name is None:
        return [*(player for player in known.values() if player.families), known[_ANY]]
    if name not in known:
        raise UsageError(f"there is no player {unknown(name, known)}")
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
    outcome: _Outcome,
) -> None:
    from envcraft.demonstrations import keeping, recording

    keeping.prune(store)
    shares: dict[tuple[str, str], list[Environment]] = {}
    strangers = 0
    for environment, family in _environments(store, select):
        player = next((player for player in players if player.plays(family)), None)
        if player is None:
            strangers += 1
        else:
            contract = promised.name if promised is not None else _passed(store, environment)
            shares.setdefault((player.name, contract), []).append(environment)
    if strangers:
        words = " and ".join(player.name for player in players)
        click.echo(f"{plural(strangers, 'environment')} left out, whose family {words} does not play", err=True)
    known = {player.name: player for player in players}
    for (name, contract), chosen in shares.items():
        under = contract_named(contract)
        with _shown() as tell:
            found = recording.record(store, chosen, known[name], under, driver, steps, seed, workers, tell)
        outcome.take(found)
        there = len(chosen) - found.done - len(found.bad)
        words = name if contract == _CONTRACT else f"{name}, {contract}"
        click.echo(
            f"{words}: {plural(found.steps, 'step')} in {plural(found.done, 'environment')} recorded, "
            f"{there:,} there already"
        )


def _passed(store: Store, environment: Environment) -> str:
    """The contract that an environment is to be played under."""
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
    outcome: _Outcome,
) -> None:
    from envcraft.demonstrations import keeping, recording

    wanted = {environment.source for environment, _ in _environments(store, select)}
    shares: dict[str, list[tuple[str, keeping.Row]]] = {}
    for one, row in keeping.rows(store, name):
        if row.source in wanted and (promised is None or row.contract == promised.name):
            shares.setdefault(row.contract, []).append((one, row))
    if not shares:
        raise UsageError(f"{store.root} has no such recording; `envcraft demos {store.root}` records some")
    count = bad = 0
    for contract, named in shares.items():
        with _shown() as tell:
            found = recording.replay(store, named, contract_named(contract), driver, not verify, workers, tell)
        outcome.take(found)
        count, bad = count + len(named), bad + len(found.bad)
    words = "played again" if verify else "played for the cache"
    click.echo(f"{plural(count, 'recording')} {words}, {bad:,} of their environments otherwise")


def _environments(store: Store, select: str | None) -> Iterator[tuple[Environment, str | None]]:
    """One for each source, with its family if it has one. Raises UsageError where there is none."""
    from envcraft.corpus.store import Environment

    rows = store.db.execute(
        "SELECT min(name), source, class, origin FROM environments WHERE ? IS NULL OR name GLOB ? "
        "GROUP BY source, class ORDER BY 1",
        (select, select),
    ).fetchall()
    if not rows:
        words = f"no environment called {select}" if select else "no environment"
        raise UsageError(f"{store.root} has {words}; `envcraft corpus list {store.root}` lists them")
    for name, source, env_class, origin in rows:
        yield Environment(name, source, env_class), json.loads(origin).get("family")


@contextlib.contextmanager
def _shown() -> Iterator[recording.Tell]:
    """Progress on standard error."""
    import io

    from envcraft.progress import Progress

    with Progress(io.StringIO()) as progress:
        try:
            yield progress.handle
        except KeyboardInterrupt:
            click.echo("what was recorded is kept; the same command goes on from there", err=True)
            raise
