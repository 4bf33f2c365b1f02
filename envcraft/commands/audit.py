"""``envcraft audit``: judge a whole corpus, or a folder, and keep every verdict."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Generator
from typing import TYPE_CHECKING, Any

import click

from envcraft import __version__
from envcraft.budget import BUDGETS
from envcraft.cli import Configured, uninterrupted
from envcraft.errors import ExitCode, UsageError
from envcraft.pool import Pool
from envcraft.reports import one_line, plural
from envcraft.sandbox import ensure
from envcraft.verdict import SCHEMA, plain

from .choices import (
    LOCAL,
    contract_named,
    driver_named,
    executor_named,
    rule_options,
    select_checks,
    where_options,
)

if TYPE_CHECKING:
    from envcraft.corpus.audit import Audit
    from envcraft.corpus.baseline import Difference
    from envcraft.corpus.store import Store
    from envcraft.events import Event

    Judging = Generator[tuple[int, Event], None, None]

#: So many codes, and so many findings of either kind, are shown to people.
_SHOWN = 10


class _Command(Configured):
    # There are fewer formats than `validate` has, and another kind of report.
    apart = frozenset({"format", "report"})


@click.command(cls=_Command)
@click.argument("place", metavar="CORPUS|FOLDER")
@click.option("--store", metavar="DIR", help="Where the verdicts on a folder are kept, in place of FOLDER/.envcraft.")
@rule_options
@where_options()
@click.option(
    "--executor",
    default=LOCAL,
    show_default=True,
    metavar="NAME",
    help="What judges: local, which is this process, or an executor of a plugin, such as dask.",
)
@click.option("--scheduler", metavar="ADDRESS", help="Where the executor's cluster is; one of this machine without it.")
@click.option(
    "--resume/--no-resume", default=True, show_default=True, help="Take verdicts that there are, or judge all anew."
)
@click.option("--sample", type=click.IntRange(1), metavar="N", help="Only so many, picked by --seed.")
@click.option("--only-failed", is_flag=True, help="Only those that failed, or could not be judged, when last judged.")
@click.option(
    "--changed", is_flag=True, help="Only what is new or changed since the last complete audit, or not judged yet."
)
@click.option("--baseline", metavar="REPORT.json", help="Tell what is new, fixed and unchanged since this report.")
@click.option("--report", metavar="DIR", help="Write a site of files about the whole corpus, with pictures and tables.")
@click.option("--previews/--no-previews", default=True, help="With --report: play a little for pictures, or do not.")
@click.option("--format", "form", type=click.Choice(["console", "json"]), default="console", show_default=True)
@click.option("--exit-zero", is_flag=True, help="Exit with 0 even if environments fail.")
@click.pass_context
def audit(
    ctx: click.Context,
    place: str,
    store: str | None,
    contract: str,
    sandbox: str,
    runtime: str | None,
    require_isolation: str | None,
    checks: str | None,
    skip: str | None,
    budget: str,
    seed: int,
    workers: int | None,
    executor: str,
    scheduler: str | None,
    resume: bool,
    sample: int | None,
    only_failed: bool,
    changed: bool,
    baseline: str | None,
    report: str | None,
    previews: bool,
    form: str,
    exit_zero: bool,
) -> None:
    """Judge every environment of a corpus, or below a folder, and keep the verdicts: only what changed is judged again.

    A run that ends in between, however it ends, goes on where it was when it is started again.

    \b
    Exit status: 0 every environment passes    1 at least one fails
                 2 wrong use                      3 something could not be judged
    """
    promised, selected = contract_named(contract), select_checks(checks, skip)
    engine = executor_named(executor)
    if engine is None and scheduler is not None:
        raise UsageError(f"--scheduler {scheduler} goes with an executor that has one, such as --executor dask")
    if engine is not None:
        engine.ensure()
    if report:
        from pathlib import Path

        from envcraft.corpus.report.command import ready, write

        ready(Path(report))
    with contextlib.ExitStack() as stack:
        driver = driver_named(sandbox, require_isolation, runtime, probe=False)
        stack.callback(driver.close)
        with uninterrupted():
            from envcraft.corpus.audit import Audit, Choice
            from envcraft.corpus.baseline import compare, read_baseline
            from envcraft.corpus.dispatch import stream as dispatch
            from envcraft.corpus.settings import settings_of
            from envcraft.corpus.tasks import Order
            from envcraft.engine import Plan, stream

        known = read_baseline(baseline) if baseline else None
        ensure(driver)
        settings = settings_of(promised, selected, driver, BUDGETS[budget], seed)
        opened, folder = _open(place, store)
        stack.enter_context(opened)
        choice = Choice(only_failed, changed, sample, seed)
        run = Audit(opened, opened.settings(settings), choice, folder, resume)
        click.echo(f"{plural(run.selected, 'environment')}, {len(run.pending):,} of them to be judged", err=True)
        if run.pending:
            plan = Plan(run.targets, promised, driver, selected, BUDGETS[budget], seed)
            if engine is None:
                judging = stream(plan, workers, stack.enter_context(Pool(driver, plan.limits, len(run.pending))))
            else:
                order = Order(settings, promised, [check.name for check in selected], runtime, require_isolation)
                judging = dispatch(engine, workers, scheduler, order, plan)
            _judge(run, judging, resume)
            for lost in run.kept:
                words = f"{lost.path}: could not be judged again ({lost.reason}); the verdict of before stays"
                click.echo(one_line(words), err=True)
        run.end()
        if report:
            write(opened, Path(report), folder, promised if previews else None, driver, workers)
        difference = compare(run, known) if known is not None else None
        verdicts = run.verdicts()
        told = {"schema": SCHEMA, "envcraft": __version__, "contract": contract, "seed": seed, "budget": budget}
        if form == "json":
            _write_json(run, told, verdicts, difference)
        else:
            _write_summary(run, verdicts, difference)
    if verdicts.get("fail") and not exit_zero:
        ctx.exit(ExitCode.FAIL)
    ctx.exit(ExitCode.ERROR if verdicts.get("error") or run.kept else ExitCode.PASS)


def _open(place: str, store: str | None) -> tuple[Store, str]:
    """The store to write to, brought up to date with the folder if it is one's; and that folder, else "".

    Raises UsageError, CorpusBusy, CorpusDamaged.
    """
    from pathlib import Path

    from envcraft.corpus.audit import follow
    from envcraft.corpus.store import BESIDE, Store, is_corpus

    from .targets import environments_below

    if is_corpus(Path(place)):
        if store is not None:
            raise UsageError(f"{place} is a corpus and keeps its own verdicts: leave out --store {store}")
        opened = Store(Path(place), write=True)
        if not opened.db.execute("SELECT 1 FROM environments").fetchone():
            opened.close()
            raise UsageError(f"the corpus {place} is empty; `envcraft corpus add {place} FOLDER` adds environments")
        return opened, ""
    if not os.path.isdir(place):
        raise UsageError(f"{place} is neither a corpus nor a folder; `envcraft validate` judges single files")
    root = Path(store) if store is not None else Path(place, BESIDE)
    if not is_corpus(root) and next(environments_below(place), None) is None:
        raise UsageError(f"{place} holds no environment: no .py file below it has a class and names gymnasium")
    opened = Store(root, write=True) if is_corpus(root) else Store.create(root, folder=True)
    try:
        if not opened.follows_folder:
            raise UsageError(
                f"--store {root} is a corpus that environments are added to; a folder's verdicts need a store of "
                "their own"
            )
        follow(opened, ((plain(os.path.relpath(target.path, place)), target) for target in environments_below(place)))
    except BaseException:
        opened.close()
        raise
    return opened, place


def _judge(run: Audit, judging: Judging, resume: bool) -> None:
    import io

    from envcraft.events import SubjectFinished
    from envcraft.progress import Progress

    judged = 0

    def tell(event: Any) -> None:
        nonlocal judged
        progress.handle(event)
        judged += isinstance(event, SubjectFinished)

    # Nothing is written while the view is up, so that it need not give way.
    with Progress(io.StringIO()) as progress:
        try:
            run.run(judging, tell)
        except KeyboardInterrupt:
            again = (
                "the same command goes on from there"
                if resume
                else "the same command judges all of them again, and without --no-resume only what has no verdict"
            )
            click.echo(f"{judged:,} of {len(run.pending):,} were judged and are kept; {again}", err=True)
            raise


def _write_json(run: Audit, told: dict[str, Any], verdicts: dict[str, int], difference: Difference | None) -> None:
    """One object as ``validate --format json`` writes it, with ``audit`` besides; the reports one by one."""
    import msgspec

    def encoded(value: Any) -> str:
        return msgspec.json.encode(plain(value)).decode()

    steps, seconds = run.totals()
    summary = {
        "number": run.number,
        "selected": run.selected,
        "judged": len(run.pending),
        "known": run.known,
        "verdicts": verdicts,
        "codes": run.codes(),
        "steps": steps,
        "seconds": seconds,
        "baseline": difference,
    }
    sys.stdout.write(encoded({**told, "audit": summary})[:-1] + ',"reports":[')
    for number, report in enumerate(run.reports()):
        sys.stdout.write(f"{',' if number else ''}\n{encoded(report)}")
    sys.stdout.write("]}\n")


def _write_summary(run: Audit, verdicts: dict[str, int], difference: Difference | None) -> None:
    words = {"pass": "passed", "fail": "failed", "error": "could not be judged"}
    counts = ", ".join(f"{verdicts[verdict]:,} {words[verdict]}" for verdict in words if verdict in verdicts)
    steps, seconds = run.totals()
    click.echo(f"{plural(run.selected, 'environment')}: {counts or 'nothing to judge'}")
    click.echo(
        f"{len(run.pending):,} judged now, {run.known:,} known; {plural(steps, 'step')} in {seconds:,.0f} s of judging"
    )
    codes = run.codes()
    for code, times in list(codes.items())[:_SHOWN]:
        click.echo(f"  {code}  in {plural(times, 'environment')}")
    if len(codes) > _SHOWN:
        click.echo(f"  and {plural(len(codes) - _SHOWN, 'more code')}")
    if difference is None:
        return
    click.echo(
        f"since the baseline: {len(difference.new):,} new, {len(difference.fixed):,} fixed, "
        f"{difference.unchanged:,} unchanged, {difference.unknown:,} not looked at"
    )
    for kind, found in (("new", difference.new), ("fixed", difference.fixed)):
        for item in found[:_SHOWN]:
            click.echo(f"  {kind}  {one_line(item.path)}: {item.code} {one_line(item.message)}")
        if len(found) > _SHOWN:
            click.echo(f"  and {len(found) - _SHOWN:,} more {kind}; --format json has them all")
