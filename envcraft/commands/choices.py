"""What the options of the command line name: contracts, checks, drivers and reporters, looked up among the plugins'."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from envcraft.budget import BUDGETS
from envcraft.check import Check, Rule
from envcraft.cli import named, offered, unknown
from envcraft.contract import Contract
from envcraft.errors import SandboxUnavailable, UsageError
from envcraft.own_contracts import own_contracts
from envcraft.reports import Reporter
from envcraft.sandbox import Driver, Isolation, choose, ensure

if TYPE_CHECKING:
    from envcraft.corpus.export import Exporter
    from envcraft.executors import ExecutorPlugin
    from envcraft.families import Family

_F = TypeVar("_F", bound=Callable[..., Any])

#: No verdict can be trusted where this check did not run: it says whether there is an environment at all.
FIRST = "source"
#: The executor that is no plugin's: the threads of the process that judges.
LOCAL = "local"
#: More than any machine has cores; each is a thread.
MOST_WORKERS = 1024


def all_checks() -> list[Check]:
    """Every check, in the order in which they run: last those that judge what the others ran into."""
    return sorted(offered("envcraft_checks"), key=lambda check: check.always)


def default_checks() -> list[Check]:
    """Those that run where none are named, in the same order."""
    return [check for check in all_checks() if not check.opt_in]


def rules_of(checks: Iterable[Check]) -> dict[str, Rule]:
    """All rules by code."""
    return {rule.code: rule for check in checks for rule in check.rules}


def select_checks(only: str | None, skip: str | None) -> list[Check]:
    """The checks that ``--checks`` and ``--skip`` leave, with those that every verdict rests on. Raises UsageError."""
    checks = all_checks()
    names = [check.name for check in checks]
    wanted, unwanted = split(only), split(skip)
    for name in [*wanted, *unwanted]:
        if name not in names:
            raise UsageError(f"there is no check {unknown(name, names)}")
    kept = [
        check
        for check in checks
        if check.name not in unwanted
        and (check.name in wanted or check.always or check.name == FIRST or (only is None and not check.opt_in))
    ]
    if not [check for check in kept if not check.always]:
        raise UsageError("no check is left; leave out some of --skip, and `envcraft checks` lists them all")
    return kept


def checks_named(names: Iterable[str]) -> list[Check]:
    """The checks of these names, in this order. Raises UsageError, naming the nearest."""
    known = {check.name: check for check in all_checks()}
    return [_named("check", name, known) for name in names]


def split(names: str | None) -> list[str]:
    """The names in a list that commas separate."""
    return [name.strip() for name in (names or "").split(",") if name.strip()]


def all_contracts() -> list[Contract]:
    """The plugins' contracts, and those of the nearest pyproject.toml. Raises UsageError where these make no sense."""
    found: list[Contract] = list(offered("envcraft_contracts"))
    return found + own_contracts(
        Path.cwd(), found, lambda: (rule.code for check in all_checks() for rule in check.rules)
    )


def contract_named(name: str) -> Contract:
    """Raises UsageError, naming the nearest."""
    found: Contract = _named("contract", name, {contract.name: contract for contract in all_contracts()})
    return found


def reporter_named(name: str) -> type[Reporter]:
    """Raises UsageError, naming the nearest."""
    found: type[Reporter] = named("envcraft_reporters", name) or _named(
        "format", name, {reporter.name: reporter for reporter in offered("envcraft_reporters")}
    )
    return found


def executor_named(name: str) -> ExecutorPlugin | None:
    """None for this process itself. Raises UsageError, naming the nearest."""
    if name == LOCAL:
        return None
    known = {executor.name: executor for executor in offered("envcraft_executors")}
    found: ExecutorPlugin | None = _named("executor", name, {LOCAL: None, **known})
    return found


def exporter_named(name: str) -> Exporter:
    """Raises UsageError, naming the nearest."""
    found: Exporter = _named("export", name, {exporter.name: exporter for exporter in offered("envcraft_exporters")})
    return found


def family_named(name: str) -> Family:
    """Raises UsageError, naming the nearest."""
    found: Family = _named("family", name, {family.name: family for family in offered("envcraft_families")})
    return found


#: ``--runtime``, for every command that takes ``--sandbox``.
runtime_option = click.option(
    "--runtime", metavar="NAME", help="Container runtime of the docker sandbox, such as runsc for gVisor."
)


def where_options(sandbox: str | None = "auto") -> Callable[[_F], _F]:
    """``--sandbox`` (with no default, it is the one that was recorded), ``--runtime``, ``--require-isolation`` and
    ``--workers``, for commands that judge.
    """
    return _together(
        click.option(
            "--sandbox",
            default=sandbox,
            show_default=sandbox or "as recorded",
            metavar="NAME",
            help="Where the environments run.",
        ),
        runtime_option,
        click.option(
            "--require-isolation",
            type=click.Choice([level.value for level in Isolation]),
            help="Judge nothing where no sandbox isolates this far.",
        ),
        click.option(
            "--workers",
            type=click.IntRange(1, MOST_WORKERS),
            show_default="as many as cores",
            help="Jobs that run side by side: of as many environments, or several of one.",
        ),
    )


def rule_options(command: _F) -> _F:
    """``--contract``, ``--checks``, ``--skip``, ``--budget`` and ``--seed``, for commands that judge."""
    return _together(
        click.option(
            "--contract", default="arcade", show_default=True, metavar="NAME", help="What the environments promise."
        ),
        click.option(
            "--checks",
            metavar="A,B",
            help="Run only these checks (and source, which the others rest on); opt-in ones run only so.",
        ),
        click.option("--skip", metavar="A,B", help="Leave out these checks."),
        click.option("--budget", type=click.Choice(list(BUDGETS)), default="standard", show_default=True),
        click.option(
            "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Same seed, same episodes."
        ),
    )(command)


def _together(*options: Callable[[Any], Any]) -> Callable[[_F], _F]:
    """One decorator in place of several, in the order in which ``--help`` lists them."""

    def decorate(command: _F) -> _F:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def driver_named(name: str, least: str | None = None, runtime: str | None = None, probe: bool = True) -> Driver:
    """The sandbox that ``--sandbox`` names, at least as strong as `least` and under `runtime`; a word on stderr where
    it is the weakest. What runs that were killed have left behind is removed first.

    Without `probe`, one that is named is not tried: that is left to the caller, to do while a worker starts.
    Raises UsageError on an unknown name, or one that knows no runtimes; SandboxUnavailable where there is none.
    """
    drivers = offered("envcraft_sandbox_drivers")
    if name != "auto":
        _named("sandbox", name, {"auto": None, **{driver.name: driver for driver in drivers}})
    for driver in drivers:
        # Nothing depends on it, and `envcraft doctor` names one that breaks.
        with contextlib.suppress(Exception):
            driver.sweep()
    if runtime is not None:
        drivers = under(runtime, drivers, name)
        # With one left, its own words say more than those of "auto".
        name = drivers[0].name if len(drivers) == 1 else name
    driver = choose(drivers, name)
    if probe:
        ensure(driver)
    levels = list(Isolation)
    if least is not None and levels.index(driver.isolation) > levels.index(Isolation(least)):
        raise SandboxUnavailable(
            f"the strongest sandbox here is {driver.name}, whose isolation is only {driver.isolation}, and "
            f"--require-isolation asks for {least}; `envcraft doctor` tells what is missing"
            if name == "auto"
            else f"the {name} sandbox isolates by {driver.isolation} only, and --require-isolation asks for {least}"
        )
    if name == "auto" and driver.isolation is Isolation.PROCESS:
        click.echo(
            "Note: neither a container nor a namespace can be had here, so the process sandbox is used, which holds "
            "against accidents, not against malice; `envcraft doctor` tells what is missing.",
            err=True,
        )
    return driver


def under(runtime: str, drivers: Iterable[Driver], name: str = "auto") -> list[Driver]:
    """Those drivers that know container runtimes, under this one. Raises UsageError where `name` is not among them."""
    found, refusals = [], {}
    for driver in drivers:
        try:
            found.append(driver.under(runtime))
        except UsageError as error:
            refusals[driver.name] = error
    if name in refusals:
        raise refusals[name]
    if not found:
        raise UsageError(f"--runtime {runtime} goes with the docker sandbox, and no plugin here has one")
    return found


def _named(kind: str, name: str, known: Mapping[str, Any]) -> Any:
    if name not in known:
        raise UsageError(f"there is no {kind} {unknown(name, known)}")
    return known[name]
