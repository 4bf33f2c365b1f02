"""``envcraft audit``: judge a corpus or a folder and store every verdict."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Generator
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from envcraft.cli import completion
from envcraft.cli.commands.audit_reports import read_audit_reports, write
from envcraft.cli.commands.outputs import report_stream
from envcraft.cli.configured import Configured
from envcraft.cli.options import check_options, format_option, output_option, policy_of, policy_option, sandbox_options
from envcraft.cli.signals import uninterrupted
from envcraft.contracts.lookup import contract_named
from envcraft.corpus.executors import LOCAL, executor_named
from envcraft.errors import ExitCode, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import ensure
from envcraft.judging.selection import driver_named, select_checks
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.verdict import SCHEMA, plain
from envcraft.text import one_line, plural
from envcraft.version import __version__

if TYPE_CHECKING:
    from envcraft.corpus.audit import Audit
    from envcraft.corpus.store import Store
    from envcraft.corpus.store.audits import Projects
    from envcraft.model.events import Event

    Judging = Generator[tuple[int, Event], None, None]


class _Command(Configured):
    # These options differ from those of `validate`.
    apart = frozenset({"format", "output", "output-format", "report"})


@click.command(cls=_Command, short_help="Judge a corpus or a folder.")
@click.argument("place", metavar="CORPUS|FOLDER", shell_complete=completion.folders)
@click.option(
    "--store",
    metavar="DIR",
    shell_complete=completion.folders,
    help="The corpus of a folder.  [default: FOLDER/.envcraft]",
)
@check_options(stages=True)
@sandbox_options()
@policy_option()
@click.option(
    "--executor",
    default=LOCAL,
    show_default=True,
    metavar="NAME",
    help="Where the jobs run: local (this machine), or an executor of a plugin, such as dask.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="The address of the executor's scheduler.  [default: a cluster on this machine]",
)
@click.option(
    "--resume/--no-resume", default=True, show_default=True, help="Keep verdicts that exist, or judge everything again."
)
@click.option(
    "--sample", type=click.IntRange(1), metavar="N", help="Judge a random sample of N environments, drawn with --seed."
)
@click.option("--only-failed", is_flag=True, help="Judge only environments whose last verdict is fail or error.")
@click.option(
    "--changed",
    is_flag=True,
    help="Judge only environments that are new, changed since the last complete audit, or not yet judged.",
)
@click.option(
    "--baseline",
    metavar="REPORT.json",
    shell_complete=completion.files,
    help="Compare the findings with those of an earlier report.",
)
@click.option(
    "--report",
    "also",
    multiple=True,
    metavar="DIR|FORMAT:FILE",
    shell_complete=completion.folders_and_reports,
    help="Write a report on the whole corpus to this folder, or one in a format of `envcraft validate` to this file. "
    "Can be repeated.",
)
@click.option("--previews/--no-previews", default=True, help="Make previews for --report.")
@format_option()
@output_option()
@click.option("--exit-zero", is_flag=True, help="Exit with 0 even if an environment fails.")
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
    budget: tuple[str, ...],
    seed: int,
    time_limit: float | None,
    fail_fast: bool,
    workers: int | None,
    policy: str | None,
    executor: str,
    scheduler: str | None,
    resume: bool,
    sample: int | None,
    only_failed: bool,
    changed: bool,
    baseline: str | None,
    also: tuple[str, ...],
    previews: bool,
    form: str | None,
    output: str | None,
    exit_zero: bool,
) -> None:
    """Judge every environment of a corpus or folder, and store the verdicts.

    Only changed environments are judged again. The same command resumes an interrupted run.

    \b
    Exit status: 0 no environment fails
                 1 at least one fails
                 2 usage error
                 3 an environment could not be judged
    """
    promised, selected = contract_named(contract), select_checks(checks, skip)
    privileged = policy_of(policy, common=True)
    engine = executor_named(executor)
    if engine is None and scheduler is not None:
        raise UsageError(f"--scheduler {scheduler} needs an executor that has a scheduler, such as --executor dask")
    if engine is not None:
        engine.ensure()
    wanted, report = read_audit_reports(form, output, also)
    if report:
        from pathlib import Path

        from envcraft.corpus.report.write import check_requirements, write_report

        check_requirements(Path(report))
    with contextlib.ExitStack() as stack:
        driver = driver_named(sandbox, require_isolation, runtime, probe=False)
        stack.callback(driver.close)
        with uninterrupted():
            from envcraft.corpus.audit import Audit
            from envcraft.corpus.baseline import compare, read_baseline
            from envcraft.corpus.dispatch import stream as dispatch
            from envcraft.corpus.store.audits import Selection
            from envcraft.corpus.tasks import Order
            from envcraft.judging.engine import Plan, stream
            from envcraft.judging.settings import settings_of

        # A file that cannot be written is an error before the judging, not after it.
        streams = [stack.enter_context(report_stream(path, not number)) for number, (_, path) in enumerate(wanted)]
        known = read_baseline(baseline) if baseline else None
        ensure(driver)
        stages = [settings_of(promised, selected, driver, BUDGETS[name], seed, privileged) for name in budget]
        opened, folder, projects = _open(place, store, promised.project)
        stack.enter_context(opened)
        selection = Selection(only_failed, changed, sample, seed)
        run = Audit(opened, opened.settings(stages[0]), selection, folder, resume, not fail_fast, projects)
        for stage, settings in enumerate(stages):
            count = run.advance(opened.settings(settings)) if stage else run.selected
            if stage and not count:
                break
            name = f"budget {settings.budget}: " if len(stages) > 1 else ""
            click.echo(f"{name}{plural(count, 'environment')}, {len(run.pending):,} of them to be judged", err=True)
            if not run.pending:
                continue
            budget_of_stage = BUDGETS[settings.budget]
            plan = Plan(
                run.targets,
                promised,
                driver,
                selected,
                budget_of_stage,
                seed,
                privileged,
                time_limit=time_limit,
                fail_fast=fail_fast,
            )
            if engine is None:
                judging = stream(plan, workers, stack.enter_context(WorkerPool(driver, plan.limits, len(run.pending))))
            else:
                order = Order(
                    settings,
                    promised,
                    [check.name for check in selected],
                    runtime,
                    require_isolation,
                    time_limit=time_limit,
                    fail_fast=fail_fast,
                    policy=privileged,
                )
                judging = dispatch(engine, workers, scheduler, order, plan)
            _judge(run, judging, resume)
        for lost in run.kept:
            words = f"could not be judged again ({lost.reason or 'out of time'}); the earlier verdict stays"
            click.echo(one_line(f"{lost.path}: {words}"), err=True)
        run.end()
        if report:
            contract_of_new = promised if previews else None
            write_report(opened, Path(report), folder, contract_of_new, driver, workers, partial(click.echo, err=True))
        difference = compare(run, known) if known is not None else None
        verdicts, outcomes = run.verdicts(), run.outcomes()
        header = {
            "schema": SCHEMA,
            "envcraft": __version__,
            "contract": contract,
            "seed": seed,
            "budget": ",".join(budget),
        }
        write(run, zip((kind for kind, _ in wanted), streams, strict=True), header, outcomes, difference)
    if verdicts.get("fail") and not exit_zero:
        ctx.exit(ExitCode.FAIL)
    ctx.exit(ExitCode.ERROR if verdicts.get("error") or run.kept else ExitCode.PASS)


def _open(place: str, store: str | None, with_projects: bool) -> tuple[Store, str, Projects | None]:
    """Open the corpus to write to, and update it if it follows a folder.

    Returns:
        The corpus; the folder that it follows or ""; and the files of projects that the folder's environments need.

    Raises:
        UsageError, CorpusBusy, CorpusDamaged: if it cannot be opened.
    """
    from pathlib import Path

    from envcraft.corpus.audit import follow
    from envcraft.corpus.store import FOLDER_CORPUS, Store, environments, is_corpus
    from envcraft.environments.targets import environments_below

    if is_corpus(Path(place)):
        if store is not None:
            raise UsageError(f"{place} is a corpus and stores its own verdicts: leave out --store {store}")
        opened = Store(Path(place), write=True)
        if not environments.count(opened):
            opened.close()
            raise UsageError(f"the corpus {place} is empty; `envcraft corpus add {place} FOLDER` adds environments")
        return opened, "", None
    if not place.strip():
        raise UsageError("CORPUS|FOLDER is empty; name a corpus or a folder, such as . for the working directory")
    if not os.path.lexists(place):
        raise UsageError(f"{place} does not exist; name a corpus or a folder")
    if not os.path.isdir(place):
        raise UsageError(f"{place} is neither a corpus nor a folder; `envcraft validate` judges single files")
    root = Path(store) if store is not None else Path(place, FOLDER_CORPUS)
    if not is_corpus(root) and next(environments_below(place), None) is None:
        raise UsageError(f"{place} holds no environment: no .py file in it defines a subclass of gymnasium.Env")
    opened = Store(root, write=True) if is_corpus(root) else Store.create(root, folder=True)
    try:
        if not opened.follows_folder:
            raise UsageError(f"--store {root} is a corpus of its own; the verdicts on a folder need a separate corpus")
        files = ((plain(os.path.relpath(target.path, place)), target) for target in environments_below(place))
        projects = follow(opened, files, with_projects)
    except BaseException:
        opened.close()
        raise
    return opened, place, projects


def _judge(run: Audit, judging: Judging, resume: bool) -> None:
    import io

    from envcraft.cli.progress import Progress
    from envcraft.model.events import SubjectFinished

    judged = 0

    def tell(event: Any) -> None:
        nonlocal judged
        progress.handle(event)
        judged += isinstance(event, SubjectFinished)

    try:
        # Nothing else is written while the progress display is active.
        with Progress(io.StringIO()) as progress:
            run.run(judging, tell)
    except KeyboardInterrupt:
        again = (
            "the same command resumes"
            if resume
            else "the same command judges all again, and without --no-resume only those without a verdict"
        )
        done = f"{judged:,} of {len(run.pending):,} were judged and stored" if judged else "none was judged"
        click.echo(f"{done}; {again}", err=True)
        raise
