"""``envcraft reverify``: judge again what validation records say, and tell what comes out differently."""

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

from envcraft.budget import BUDGETS
from envcraft.cli import uninterrupted
from envcraft.errors import ExitCode, TargetLost, UsageError
from envcraft.pool import Pool
from envcraft.reports import one_line, plural
from envcraft.sandbox import Driver, ensure
from envcraft.target import LazyTargets, Target, read_target
from envcraft.verdict import SubjectReport, Verdict

from .choices import checks_named, contract_named, driver_named, where_options

if TYPE_CHECKING:
    from envcraft.corpus.records import Record
    from envcraft.corpus.settings import Settings
    from envcraft.corpus.store import Store

_SAMPLE = re.compile(r"(\d+(?:\.\d+)?)(%?)")


@click.command()
@click.argument("place", metavar="RECORDS|CORPUS")
@click.option(
    "--corpus", metavar="CORPUS", help="Where the sources of a file of records are; else files by their names."
)
@click.option("--sample", metavar="N|P%", help="Only so many, or such a share, picked by --seed.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Same seed, same sample.")
@where_options(sandbox=None)
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
) -> None:
    """Judge again what was recorded, under the settings that were recorded, and tell any drift: in the verdict of each
    check, its evidence, and the traces.

    \b
    Exit status: 0 all as recorded    1 something drifted
                 2 wrong use          3 something could not be judged
    """
    with contextlib.ExitStack() as stack:
        with uninterrupted():
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
            raise UsageError(f"{place} has no verdict to repeat; `envcraft audit` gives verdicts")
        chosen = choose(known, sample, seed)
        came_out: Counter[ExitCode] = Counter()
        for group in _groups(chosen):
            named = sandbox or group[0].settings.driver
            if sandbox is None and named == "process" and not os.path.isdir(place):
                # Who wrote the file does not choose how far its environments are isolated.
                raise UsageError(
                    f"{place} was judged in the sandbox process, which isolates least: --sandbox process judges there "
                    "again, --sandbox auto in the strongest that works here"
                )
            driver = driver_named(named, require_isolation, runtime, probe=False)
            with contextlib.closing(driver):
                ensure(driver)
                came_out.update(_again(group, driver, workers, lambda record: _target(record, place, store)))
    click.echo(
        f"{len(chosen):,} of {plural(len(known), 'record')} judged again: {came_out[ExitCode.PASS]:,} as recorded, "
        f"{came_out[ExitCode.FAIL]:,} drifted, {came_out[ExitCode.ERROR]:,} could not be judged"
    )
    ctx.exit(next((code for code in (ExitCode.FAIL, ExitCode.ERROR) if came_out[code]), ExitCode.PASS))


def choose(known: list[Record], sample: str | None, seed: int) -> list[Record]:
    """As many as ``--sample`` says, in their order. Raises UsageError."""
    if sample is None:
        return known
    told = _SAMPLE.fullmatch(sample)
    number = float(told[1]) if told else 0.0
    if told is None or number == 0 or (told[2] and number > 100) or (not told[2] and number % 1):
        raise UsageError(f"--sample {sample} is neither a number of records, such as 50, nor a share, such as 1%")
    size = math.ceil(len(known) * number / 100) if told[2] else min(int(number), len(known))
    return [known[at] for at in sorted(random.Random(seed).sample(range(len(known)), size))]


def _groups(records: Iterable[Record]) -> Iterable[list[Record]]:
    """Those that one plan judges: of the same settings and checks."""
    found: dict[tuple[Settings, tuple[str, ...]], list[Record]] = {}
    for record in records:
        found.setdefault((record.settings, tuple(check.check for check in record.checks)), []).append(record)
    return found.values()


def _target(record: Record, place: str, store: Store | None) -> Target:
    """The source of a record: from the corpus if there is one, else the file of its name in the working directory or
    beside the records. Raises TargetLost where it is not there, or is not what was recorded.
    """
    path, reason = record.path, f"{record.path} is not here; name the corpus that it is in with --corpus"
    if store is not None:
        from envcraft.corpus.store import CorpusDamaged

        try:
            return Target(path, store.source(record.source_sha256), record.env_class)
        except CorpusDamaged as error:
            reason = str(error)
    else:
        for file in (path, os.path.join(os.path.dirname(place), path)):
            with contextlib.suppress(UsageError):
                target = read_target(file, record.env_class)
                if target.sha256 == record.source_sha256:
                    return target
                reason = f"{file} has changed since it was recorded"
    raise TargetLost(path, record.env_class, record.source_sha256, reason)


def _again(
    records: Sequence[Record], driver: Driver, workers: int | None, find: Callable[[Record], Target]
) -> Iterator[ExitCode]:
    """Judge records of the same settings again; tell of each that does not come out as recorded."""
    from envcraft.corpus.settings import settings_of
    from envcraft.engine import Plan, stream
    from envcraft.events import SubjectFinished
    from envcraft.progress import Progress

    settings = records[0].settings
    contract, checks = contract_named(settings.contract), checks_named(check.check for check in records[0].checks)
    if settings.budget not in BUDGETS:
        raise UsageError(f"the records name the budget {one_line(settings.budget)}, which there is not")
    budget = BUDGETS[settings.budget]
    differing = settings_of(contract, checks, driver, budget, settings.seed).differing(settings)
    because = f" (judged now by {one_line('; '.join(differing))})" if differing else ""
    plan = Plan(LazyTargets(records, find), contract, driver, checks, budget, settings.seed)
    with (
        Pool(driver, plan.limits, len(records)) as pool,
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
    """How a record comes out, and in words why, where it is not the same."""
    from envcraft.corpus.records import drift

    if report.verdict is Verdict.ERROR:
        return ExitCode.ERROR, f"could not be judged: {one_line(report.reason)}"
    verdicts, details = drift(record, report)
    if details and not verdicts and record.unsteady:
        return ExitCode.PASS, f"{', '.join(details)}, as may be: it was recorded as not deterministic"
    return (ExitCode.FAIL if verdicts or details else ExitCode.PASS), ", ".join([*verdicts, *details])
