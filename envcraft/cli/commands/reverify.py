"""``envcraft reverify``: judge recorded environments again and report differences."""

from __future__ import annotations

import contextlib
import math
import os
import random
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from envcraft.cli import completion
from envcraft.cli.options import policy_of, policy_option, sandbox_options
from envcraft.cli.signals import uninterrupted
from envcraft.contracts.lookup import contract_named
from envcraft.errors import ExitCode, TargetLost, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Driver, ensure
from envcraft.judging.selection import checks_named, driver_named
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.project import with_project
from envcraft.model.target import LazyTargets, Target, read_target
from envcraft.model.verdict import SubjectReport, Verdict
from envcraft.text import one_line, plural

if TYPE_CHECKING:
    from envcraft.corpus.records import Record
    from envcraft.corpus.store import Environment, Store
    from envcraft.judging.settings import Settings
    from envcraft.model.target import PolicyFile

_SAMPLE = re.compile(r"(\d+(?:\.\d+)?)(%?)")


@click.command(short_help="Judge recorded environments again.")
@click.argument("place", metavar="RECORDS|CORPUS", shell_complete=completion.files)
@click.option(
    "--corpus",
    metavar="CORPUS",
    shell_complete=completion.folders,
    help="The corpus with the sources.  [default: the files that the records name]",
)
@click.option("--sample", metavar="N|P%", help="Judge a random sample: N records, or P percent of them.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="The seed of the sample.")
@sandbox_options(sandbox=None)
@policy_option()
@click.pass_context
def reverify(
    ctx: click.Context,
    place: str,
    corpus: str | None,
    sample: str | None,
    seed: int,
    sandbox: str | None,
    runtime: str | None,
    require_isolation: str | None,
    workers: int | None,
    policy: str | None,
) -> None:
    """Judge recorded environments again under the recorded settings.

    The command reports drift: other verdicts of checks, other evidence or other traces.

    \b
    Exit status: 0 all as recorded
                 1 drift
                 2 usage error
                 3 an environment could not be judged
    """
    privileged = policy_of(policy, common=True)
    with contextlib.ExitStack() as stack:
        with uninterrupted():
            from envcraft.corpus.audit import stored_reader
            from envcraft.corpus.records import read, records_of
            from envcraft.corpus.store import Store
        if os.path.isdir(place):
            if corpus is not None:
                raise UsageError(f"{place} has its own sources: leave out --corpus {corpus}")
            store: Store | None = stack.enter_context(Store(Path(place)))
            assert store is not None
            known = list(records_of(store))
        else:
            known = read(place)
            store = stack.enter_context(Store(Path(corpus))) if corpus is not None else None
        if not known:
            raise UsageError(f"{place} has no verdict to repeat; `envcraft audit` makes verdicts")
        chosen = choose(known, sample, seed)
        stored = stored_reader(store) if store is not None else None
        came_out: Counter[ExitCode] = Counter()
        for group in _groups(chosen):
            named = sandbox or group[0].settings.driver
            if sandbox is None and named == "process" and not os.path.isdir(place):
                # The author of the file must not choose the weakest isolation.
                raise UsageError(
                    f"{place} was judged in the sandbox process, which isolates least: choose --sandbox process, or "
                    "--sandbox auto for the strongest sandbox that works here"
                )
            driver = driver_named(named, require_isolation, runtime, probe=False)
            with contextlib.closing(driver):
                ensure(driver)
                found = _again(group, driver, workers, privileged, lambda record: _target(record, place, stored))
                came_out.update(found)
    click.echo(
        f"{len(chosen):,} of {plural(len(known), 'record')} judged again: {came_out[ExitCode.PASS]:,} as recorded, "
        f"{came_out[ExitCode.FAIL]:,} drifted, {came_out[ExitCode.ERROR]:,} could not be judged"
    )
    ctx.exit(next((code for code in (ExitCode.FAIL, ExitCode.ERROR) if came_out[code]), ExitCode.PASS))


def choose(known: list[Record], sample: str | None, seed: int) -> list[Record]:
    """The sample of ``--sample``, in the order of the records. Raises UsageError."""
    if sample is None:
        return known
    match = _SAMPLE.fullmatch(sample)
    number = float(match[1]) if match else 0.0
    if match is None or number == 0 or (match[2] and number > 100) or (not match[2] and number % 1):
        raise UsageError(f"--sample {sample} is neither a number of records, such as 50, nor a share, such as 1%")
    size = math.ceil(len(known) * number / 100) if match[2] else min(int(number), len(known))
    return [known[at] for at in sorted(random.Random(seed).sample(range(len(known)), size))]


def _groups(records: Iterable[Record]) -> Iterable[list[Record]]:
    """The records by all that a plan needs."""
    found: dict[tuple[Settings, tuple[str, ...], bool], list[Record]] = {}
    for record in records:
        key = record.settings, tuple(check.check for check in record.checks), record.fail_fast
        found.setdefault(key, []).append(record)
    return found.values()


def _target(record: Record, place: str, stored: Callable[[Environment], Target] | None) -> Target:
    """The source of a record: from the corpus, or a file in the working directory or beside the records.

    Raises:
        TargetLost: if the source is missing or has changed.
    """
    path, reason = record.path, f"{record.path} is missing; name its corpus with --corpus"
    if stored is not None:
        from envcraft.corpus.store import Environment

        return stored(Environment(path, record.source_sha256, record.env_class or ""))
    for file in (path, os.path.join(os.path.dirname(place), path)):
        with contextlib.suppress(UsageError):
            target = read_target(file, record.env_class)
            if target.sha256 == record.source_sha256:
                return with_project(target)
            reason = f"{file} has changed since it was recorded"
    raise TargetLost(path, record.env_class, record.source_sha256, reason)


def _again(
    records: Sequence[Record],
    driver: Driver,
    workers: int | None,
    policy: PolicyFile | None,
    find: Callable[[Record], Target],
) -> Iterator[ExitCode]:
    """Judge records of the same settings again, and report each difference."""
    from envcraft.cli.progress import Progress
    from envcraft.judging.engine import Plan, stream
    from envcraft.judging.settings import settings_of
    from envcraft.model.events import SubjectFinished

    settings = records[0].settings
    contract, checks = contract_named(settings.contract), checks_named(check.check for check in records[0].checks)
    if settings.budget not in BUDGETS:
        raise UsageError(f"the records name an unknown budget, {one_line(settings.budget)}")
    budget = BUDGETS[settings.budget]
    differing = settings_of(contract, checks, driver, budget, settings.seed, policy).differing(settings)
    because = f" (judged now by {one_line('; '.join(differing))})" if differing else ""
    plan = Plan(
        LazyTargets(records, find),
        contract,
        driver,
        checks,
        budget,
        settings.seed,
        policy,
        fail_fast=records[0].fail_fast,
    )
    with (
        WorkerPool(driver, plan.limits, len(records)) as pool,
        Progress() as progress,
        contextlib.closing(stream(plan, workers, pool)) as events,
    ):
        for number, event in events:
            progress.handle(event)
            if isinstance(event, SubjectFinished):
                code, words = _compare(records[number - 1], event.report)
                if words:
                    click.echo(
                        f"{one_line(records[number - 1].path)}: {words}{because if code is ExitCode.FAIL else ''}"
                    )
                yield code
    if differing:
        click.echo(f"Note: the records were made under other settings{because}", err=True)


def _compare(record: Record, report: SubjectReport) -> tuple[ExitCode, str]:
    """The exit status for a record, and the differences from it."""
    from envcraft.corpus.records import drift

    if report.verdict is Verdict.ERROR:
        return ExitCode.ERROR, f"could not be judged: {one_line(report.reason)}"
    if report.out_of_time:
        return ExitCode.ERROR, "could not be judged: it ran out of time"
    verdicts, details = drift(record, report)
    if details and not verdicts and not record.deterministic:
        return ExitCode.PASS, f"{', '.join(details)}; allowed, because it was recorded as not deterministic"
    return (ExitCode.FAIL if verdicts or details else ExitCode.PASS), ", ".join([*verdicts, *details])
