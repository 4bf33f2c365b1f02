"""``envcraft validate``: judge environments."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

import click
import msgspec

from envcraft.budget import BUDGETS
from envcraft.cli import Configured, uninterrupted
from envcraft.errors import ExitCode, UsageError
from envcraft.pool import Pool
from envcraft.reports import Reporter
from envcraft.sandbox import Limits, driver_for, ensure
from envcraft.target import Kind, Target, kind_of, read_policy
from envcraft.verdict import Report, Verdict

from .choices import (
    all_checks,
    contract_named,
    driver_named,
    reporter_named,
    rule_options,
    rules_of,
    select_checks,
    where_options,
)
from .outputs import whole
from .targets import resolve


@click.command(cls=Configured)
@click.argument("targets", nargs=-1, required=True, metavar="TARGET...")
@rule_options
@click.option("--class", "env_class", metavar="NAME", help="Judge this class, where a file defines several.")
@click.option("--kwargs", metavar="JSON", help="Arguments for the constructors, as a JSON object.")
@click.option("--wrap", multiple=True, metavar="MODULE:FUNC", help="Wrap each instance by this; repeat for several.")
@where_options()
@click.option("--policy", metavar="FILE", help="A privileged policy that difficulty plays with.")
@click.option("--format", "form", default="console", show_default=True, metavar="NAME", help="How to report.")
@click.option("--output", metavar="FILE", help="Where to report; - is standard output.")
@click.option(
    "--report",
    "also",
    multiple=True,
    metavar="FORMAT:FILE",
    help="Report in this format to this file, too; repeat for several.",
)
@click.option("--environments-only", is_flag=True, help="Leave out files that define no environment.")
@click.option("--exit-zero", is_flag=True, help="Exit with 0 even if environments fail.")
@click.pass_context
def validate(
    ctx: click.Context,
    targets: tuple[str, ...],
    contract: str,
    env_class: str | None,
    kwargs: str | None,
    wrap: tuple[str, ...],
    sandbox: str,
    runtime: str | None,
    require_isolation: str | None,
    checks: str | None,
    skip: str | None,
    budget: str,
    seed: int,
    policy: str | None,
    workers: int | None,
    form: str,
    output: str | None,
    also: tuple[str, ...],
    environments_only: bool,
    exit_zero: bool,
) -> None:
    """Judge environments: Python files, folders with some, package.module:Class, or ids like CartPole-v1.

    \b
    Exit status: 0 every environment passes    1 at least one fails
                 2 wrong use                      3 something could not be judged
    """
    wanted, promised = read_reports(form, output, also), contract_named(contract)
    changes = {"kwargs": read_kwargs(kwargs), "wrappers": read_wrappers(wrap)}
    files, unusable = _files(targets, env_class, environments_only, changes)
    if not files and (unusable or not environments_only):
        ctx.exit(ExitCode.USAGE)

    privileged = read_policy(policy) if policy else None
    report = None
    with contextlib.ExitStack() as stack:
        driver = driver_for(driver_named(sandbox, require_isolation, runtime, probe=False), files)
        stack.callback(driver.close)
        pool = stack.enter_context(Pool(driver, Limits(), len(files)))
        # The first worker is starting: now is the time for all that takes time.
        selected = select_checks(checks, skip)
        streams = [sys.stdout if path in (None, "-") else stack.enter_context(_report_file(path)) for _, path in wanted]
        with uninterrupted():
            from envcraft.engine import Plan
            from envcraft.engine import validate as judge
            from envcraft.progress import Progress
        pool.settle()
        ensure(driver)
        plan = Plan(files, promised, driver, selected, BUDGETS[budget], seed, privileged)
        progress = stack.enter_context(Progress(streams[0]))
        rules = rules_of(all_checks())
        reporters = [kind(stream, rules) for (kind, _), stream in zip(wanted, streams, strict=True)]
        filmed = [reporter for reporter in reporters if reporter.wants_frames]
        if filmed:
            from envcraft.frames import Film

            film = stack.enter_context(Film(plan))
            for reporter in filmed:
                reporter.frames = film
        for event in stack.enter_context(contextlib.closing(judge(plan, workers, pool))):
            progress.handle(event)
            for reporter in reporters:
                reporter.handle(event)
            report = getattr(event, "report", None)
    assert isinstance(report, Report)
    ctx.exit(ExitCode.USAGE if unusable else exit_code(report, exit_zero))


def exit_code(report: Report, exit_zero: bool = False) -> ExitCode:
    """The exit status for a report: any failure comes before any error."""
    verdicts = {subject.verdict for subject in report.reports}
    if Verdict.FAIL in verdicts and not exit_zero:
        return ExitCode.FAIL
    return ExitCode.ERROR if Verdict.ERROR in verdicts else ExitCode.PASS


def read_reports(form: str, output: str | None, also: Iterable[str]) -> list[tuple[type[Reporter], str | None]]:
    """The reporters that the options ask for, each with its file: the one of ``--format`` first, None being standard
    output. Raises UsageError.
    """
    found = [(reporter_named(form), output)]
    for words in also:
        name, _, path = words.partition(":")
        if not path:
            raise UsageError(f"--report {words} is not FORMAT:FILE, such as sarif:report.sarif")
        found.append((reporter_named(name), path))
    files = [os.path.realpath(path) for _, path in found if path]
    for path in files:
        if files.count(path) > 1:
            raise UsageError(f"two reports cannot be written to one file, {path}")
    return found


def read_kwargs(text: str | None) -> dict[str, Any]:
    """The constructor's arguments that ``--kwargs`` gives. Raises UsageError."""
    try:
        value = json.loads(text or "{}")
    except (ValueError, RecursionError) as error:
        raise UsageError(f"--kwargs {text} is not JSON: {error}") from None
    if not isinstance(value, dict):
        raise UsageError(f"--kwargs {text} is no JSON object; write it like '{{\"size\": 8}}'")
    return value


def read_wrappers(names: tuple[str, ...]) -> tuple[str, ...]:
    """What ``--wrap`` names. Raises UsageError where one is not ``module:func``."""
    for name in names:
        if kind_of(name) is not Kind.MODULE:
            raise UsageError(f"--wrap {name} is not MODULE:FUNC, such as gymnasium.wrappers:FlattenObservation")
    return names


def _files(
    targets: tuple[str, ...], env_class: str | None, environments_only: bool, changes: dict[str, Any]
) -> tuple[list[Target], bool]:
    """Everything to judge, once; and whether some target could not be used, of which stderr has a sentence."""
    files: dict[str, Target] = {}
    unusable = False
    for path in targets:
        try:
            for target in resolve(path, env_class, environments_only):
                files.setdefault(target.path, msgspec.structs.replace(target, **changes))
        except UsageError as error:
            click.echo(f"Error: {error}", err=True)
            unusable = True
    return list(files.values()), unusable


@contextlib.contextmanager
def _report_file(path: str) -> Iterator[TextIO]:
    """Raises UsageError."""
    with whole(path, "the report ") as data:
        stream = io.TextIOWrapper(data, "utf-8")
        try:
            yield stream
        finally:
            stream.detach()


def open_output(path: str) -> TextIO:
    """What ``--output`` names. Raises UsageError."""
    try:
        return open(path, "w", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"the report {path} cannot be written: {error.strerror}") from None
