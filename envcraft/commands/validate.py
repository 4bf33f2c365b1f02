"""``envcraft validate``: judge environments."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING, TextIO

import click

from envcraft.budget import BUDGETS
from envcraft.cli import Configured
from envcraft.errors import ExitCode, UsageError
from envcraft.sandbox import Isolation
from envcraft.verdict import Report, Verdict

from .choices import all_checks, contract_named, driver_named, reporter_named, rules_of, select_checks
from .targets import resolve

if TYPE_CHECKING:
    from envcraft.subject import Target


@click.command(cls=Configured)
@click.argument("targets", nargs=-1, required=True, metavar="TARGET...")
@click.option("--contract", default="arcade", show_default=True, metavar="NAME", help="What the environments promise.")
@click.option("--class", "env_class", metavar="NAME", help="Judge this class, where a file defines several.")
@click.option("--sandbox", default="auto", show_default=True, metavar="NAME", help="Where the environments run.")
@click.option(
    "--require-isolation",
    type=click.Choice([level.value for level in Isolation]),
    help="Judge nothing where no sandbox isolates this far.",
)
@click.option("--checks", metavar="A,B", help="Run only these checks (and source, which the others rest on).")
@click.option("--skip", metavar="A,B", help="Leave out these checks.")
@click.option("--budget", type=click.Choice(list(BUDGETS)), default="standard", show_default=True)
@click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Same seed, same episodes."
)
@click.option("--policy", metavar="FILE", help="A privileged policy that difficulty plays with.")
@click.option(
    "--workers", type=click.IntRange(1, 64), default=1, show_default=True, help="Environments judged side by side."
)
@click.option("--format", "form", default="console", show_default=True, metavar="NAME", help="How to report.")
@click.option("--output", metavar="FILE", help="Where to report, in place of standard output.")
@click.option("--exit-zero", is_flag=True, help="Exit with 0 even if environments fail.")
@click.pass_context
def validate(
    ctx: click.Context,
    targets: tuple[str, ...],
    contract: str,
    env_class: str | None,
    sandbox: str,
    require_isolation: str | None,
    checks: str | None,
    skip: str | None,
    budget: str,
    seed: int,
    policy: str | None,
    workers: int,
    form: str,
    output: str | None,
    exit_zero: bool,
) -> None:
    """Judge environments: Python files, or folders with some.

    \b
    Exit status: 0 every environment passes    1 at least one fails
                 2 wrong use                      3 something could not be judged
    """
    reporter_class, promised = reporter_named(form), contract_named(contract)
    selected = select_checks(checks, skip)
    files, unusable = _files(targets, env_class)
    if not files:
        ctx.exit(ExitCode.USAGE)

    from envcraft.engine import Plan
    from envcraft.engine import validate as judge
    from envcraft.progress import Progress
    from envcraft.subject import read_policy

    privileged = read_policy(policy) if policy else None
    report = None
    with contextlib.ExitStack() as stack:
        stream: TextIO = stack.enter_context(_open(output)) if output else sys.stdout
        driver = driver_named(sandbox, require_isolation)
        stack.callback(driver.close)
        plan = Plan(files, promised, driver, selected, BUDGETS[budget], seed, privileged)
        progress = stack.enter_context(Progress())
        reporter = reporter_class(stream, rules_of(all_checks()))
        for event in stack.enter_context(contextlib.closing(judge(plan, workers))):
            progress.handle(event)
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


def _files(targets: tuple[str, ...], env_class: str | None) -> tuple[list[Target], bool]:
    """Every file to judge, once; and whether some target could not be used, of which stderr has a sentence."""
    files: dict[str, Target] = {}
    unusable = False
    for path in targets:
        try:
            files.update((target.path, target) for target in resolve(path, env_class) if target.path not in files)
        except UsageError as error:
            click.echo(f"Error: {error}", err=True)
            unusable = True
    return list(files.values()), unusable


def _open(path: str) -> TextIO:
    try:
        return open(path, "w", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"--output {path} cannot be written: {error.strerror}") from None
