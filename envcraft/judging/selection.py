"""Select checks and sandboxes by the names in options and settings."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence

import click

from envcraft.errors import SandboxUnavailable, UsageError
from envcraft.judging.check import Check, Rule
from envcraft.judging.driver import Driver, Isolation, choose, ensure
from envcraft.registry import did_you_mean, lookup, offered


def all_checks() -> list[Check]:
    """Every check in the order in which they run: gates first, and those that always run last."""
    return sorted(offered("envcraft_checks"), key=lambda check: (not check.gate, check.always))


def default_checks() -> list[Check]:
    """The checks that run when none is named, in the same order."""
    return [check for check in all_checks() if not check.opt_in]


def rules_of(checks: Iterable[Check]) -> dict[str, Rule]:
    """All rules by code."""
    return {rule.code: rule for check in checks for rule in check.rules}


def like_a_rule(name: str, checks: Sequence[Check], others: Iterable[str] = ()) -> str:
    """Describe an unknown code, with the one that it may mean. It may be the name that reports show beside a code.

    Args:
        name: what the user wrote.
        checks: whose rules there are.
        others: what else may stand in its place.
    """
    # Slow to import, and needed only for an error.
    import difflib

    codes = {rule.name: code for code, rule in rules_of(checks).items()}
    if near := difflib.get_close_matches(name.lower(), codes, n=1, cutoff=0.85):
        return f"{name.lower()!r}; did you mean {codes[near[0]]}?"
    return did_you_mean(name, [*codes.values(), *others])


def select_checks(
    only: str | None, skip: str | None, select: tuple[str, ...] = (), ignore: tuple[str, ...] = ()
) -> list[Check]:
    """The checks that ``--checks`` and ``--skip`` leave, and those that always run.

    Args:
        only: the value of ``--checks``.
        skip: the value of ``--skip``.
        select: codes or their first characters; a check with no such rule is left out.
        ignore: codes or their first characters; a check with no other rule is left out.

    Raises:
        UsageError: a name or a code does not exist, or no check is left.
    """
    checks = all_checks()
    names = [check.name for check in checks]
    wanted, unwanted = split(only), split(skip)
    codes = list(rules_of(checks))
    for name in [*wanted, *unwanted]:
        if name not in names:
            setting, instead = ("checks", "select") if name in wanted else ("skip", "ignore")
            # A gate cannot be skipped.
            offers = names if setting == "checks" else [check.name for check in checks if not check.gate]
            words = f"there is no check {did_you_mean(name, offers)}"
            if name.upper() in codes:
                words = f"{name} is a code, and --{setting} takes checks; name --{instead} {name.upper()}"
            raise UsageError(words, setting=setting)
    for code in [*select, *ignore]:
        if not any(known.startswith(code) for known in codes):
            setting = "select" if code in select else "ignore"
            raise UsageError(f"there is no rule {like_a_rule(code, checks)}", setting=setting)
    for code in ignore:
        if not any(check.waivable(rule.code) for check in checks for rule in check.rules if rule.code.startswith(code)):
            raise UsageError(f"{code} cannot be ignored, because other verdicts depend on it", setting="ignore")

    def counts(rule: Rule) -> bool:
        return (not select or rule.code.startswith(select)) and not (ignore and rule.code.startswith(ignore))

    kept = [
        check
        for check in checks
        if check.name not in unwanted
        and (check.always or check.gate or any(map(counts, check.rules)))
        and (check.name in wanted or check.always or check.gate or (only is None and not check.opt_in))
    ]
    named = {check.name for check in checks if select and any(map(counts, check.rules))}
    if not [check for check in kept if not (check.always or check.gate) or check.name in {*wanted, *named}]:
        values = {"checks": only, "skip": skip, "select": ",".join(select) or None, "ignore": ",".join(ignore) or None}
        options = {name: f"--{name} {value!r}" for name, value in values.items() if value is not None}
        verb = "leaves" if len(options) == 1 else "leave"
        words = f"{' and '.join(options.values())} {verb} no check to run; `envcraft checks` lists them all"
        raise UsageError(words, setting=[*options, ""][0])
    if needed := [check.name for check in checks if check.gate and check.name in unwanted]:
        words = f"--skip {needed[0]} is not possible: the other checks need the environment that {needed[0]} constructs"
        raise UsageError(words, setting="skip")
    return kept


def checks_named(names: Iterable[str]) -> list[Check]:
    """The checks of these names, in this order. Raises UsageError, naming the nearest."""
    known = {check.name: check for check in all_checks()}
    return [lookup("check", name, known) for name in names]


def split(names: str | None) -> list[str]:
    """The names in a list that commas separate."""
    return [name.strip() for name in (names or "").split(",") if name.strip()]


def driver_named(name: str, least: str | None = None, runtime: str | None = None, probe: bool = True) -> Driver:
    """Return the driver that ``--sandbox`` selects, after a cleanup of what killed runs left behind.

    If ``auto`` selects the weakest driver, a note goes to stderr.

    Args:
        name: the name of a driver, or ``auto``.
        least: the minimum isolation level.
        runtime: the container runtime.
        probe: whether to check that the driver works. A caller that passes False checks while the first worker starts.

    Raises:
        UsageError: the name is unknown, or the driver does not run containers.
        SandboxUnavailable: no driver meets the request.
    """
    drivers = offered("envcraft_sandbox_drivers")
    if name != "auto":
        lookup("sandbox", name, {"auto": None, **{driver.name: driver for driver in drivers}})
    for driver in drivers:
        # A failed cleanup must not stop the run, and `envcraft doctor` reports a broken driver.
        with contextlib.suppress(Exception):
            driver.sweep()
    if runtime is not None:
        drivers = under(runtime, drivers, name)
        # If one driver is left, its own error is more specific than that of "auto".
        name = drivers[0].name if len(drivers) == 1 else name
    driver = choose(drivers, name)
    if probe:
        ensure(driver)
    levels = list(Isolation)
    if least is not None and levels.index(driver.isolation) > levels.index(Isolation(least)):
        raise SandboxUnavailable(
            f"the strongest sandbox here is {driver.name}, whose isolation is only {driver.isolation}, and "
            f"{least} isolation is required; `envcraft doctor` lists what is missing"
            if name == "auto"
            else f"the {name} sandbox isolates by {driver.isolation} only, and {least} isolation is required",
            setting="require-isolation",
        )
    if name == "auto" and driver.isolation is Isolation.PROCESS:
        click.echo(
            "Note: neither containers nor namespaces are available here, so the process sandbox is used, which "
            "protects against accidents, not against malice; `envcraft doctor` lists what is missing.",
            err=True,
        )
    return driver


def under(runtime: str, drivers: Iterable[Driver], name: str = "auto") -> list[Driver]:
    """Return the drivers that run containers, with this runtime. Raises UsageError if `name` is not among them."""
    found, refusals = [], {}
    for driver in drivers:
        try:
            found.append(driver.with_runtime(runtime))
        except UsageError as error:
            refusals[driver.name] = error
    if name in refusals:
        raise refusals[name]
    if not found:
        raise UsageError(f"--runtime {runtime} requires the docker sandbox, and no installed plugin has one")
    return found
