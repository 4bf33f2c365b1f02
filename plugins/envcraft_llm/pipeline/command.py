"""``envcraft generate --concepts N``: concepts through all stages, into a corpus."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from envcraft.budget import BUDGETS
from envcraft.cli import uninterrupted
from envcraft.commands.choices import where_options
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.reports import one_line, plural
from envcraft_llm.endpoint import ModelChoice, model_options

from .options import (
    answerable,
    demo_folder,
    driver_for_generated,
    is_demo,
    judges,
    named,
    offered_stages,
    opened,
    playable,
    running,
    stage_named,
)

if TYPE_CHECKING:
    from envcraft.corpus.history import History
    from envcraft.corpus.store import Store
    from envcraft.stages import Case, Stage, Workbench
    from envcraft_llm.endpoint.accounts import Accounts
    from envcraft_llm.model import Model

    from .runner import Run

#: Where the demo goes unless told.
_DEMO_CORPUS = "envcraft-demo"
#: So many concepts are under way for each core that judges, and for each request at the endpoint.
_EACH_CORE, _EACH_REQUEST = 4, 2


@click.command(name="concepts")
@click.option("--concepts", type=click.IntRange(1), metavar="N", help="So many concepts, through all stages.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0)
@click.option("--corpus", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--with", "optional", metavar="STAGE", multiple=True, help="Run this optional stage too, such as elaboration."
)
@click.option("--from", "first", metavar="STAGE", help="Begin there, with what has come so far.")
@click.option("--until", "last", metavar="STAGE", help="Go no further than this stage.")
@click.option("--offline", is_flag=True, help="Ask nobody: answers come from the corpus's journal.")
@model_options
@click.option(
    "--budget", type=click.Choice(list(BUDGETS)), help="Of judging.  [default: standard; quick for --model demo]"
)
@where_options()
@click.pass_context
def pipeline(
    ctx: click.Context,
    concepts: int | None,
    seed: int,
    corpus: Path | None,
    optional: tuple[str, ...],
    first: str | None,
    last: str | None,
    offline: bool,
    chosen: ModelChoice,
    budget: str | None,
    sandbox: str,
    runtime: str | None,
    require_isolation: str | None,
    workers: int | None,
) -> None:
    """Concepts through all stages, into a corpus."""
    offered = offered_stages()
    begin, end, *others = (stage_named(name, offered) for name in (first, last, *optional))
    # One that a run begins or ends with is one that it has.
    stages = running(offered, {begin, end, *others})
    names = [stage.name for stage in stages]
    if begin and end and names.index(begin) > names.index(end):
        raise UsageError(f"--from {begin} comes after --until {end}; the stages are {', '.join(names)}")
    if corpus is None and not is_demo(chosen):
        raise UsageError("say where to: --corpus DIR")
    corpus = corpus or Path(_DEMO_CORPUS)
    with uninterrupted():
        cases = _cases(concepts, seed, chosen)
        answerable(chosen, corpus, offline)
    ids = [case.concept for case in cases]
    with contextlib.ExitStack() as stack:
        driver = driver_for_generated(sandbox, require_isolation, runtime)
        stack.callback(driver.close)
        if is_demo(chosen):
            playable(chosen, driver)
        with uninterrupted():
            from envcraft.corpus.history import History

            from .bench import Bench
            from .runner import Run
            from .tables import rows
            from .view import View

            judging, settings = judges(driver, budget or ("quick" if is_demo(chosen) else "standard"), workers)
        stack.enter_context(judging)
        store = stack.enter_context(_opened_store(corpus))
        history = History(store, settings)
        # First, so that a journal that cannot be used leaves no concepts behind.
        model, accounts = opened(chosen, store.root, offline)
        history.keep_concepts(cases)
        run = Run(history, stages, begin, end)
        bench = Bench(history, model, judging, lambda stage: named(chosen, stage), chosen.effort)
        view = View(rows(history, stages, ids), run.tally, accounts)
        run.told = view.tell
        at_once = _at_once(len(ids), judging.workers, chosen)
        try:
            # The view ends first, so that nothing is written into it.
            with _interrupted(run, ids), view:
                asyncio.run(_through(run, ids, bench, model, at_once))
        finally:
            _summary(history, stages, ids, accounts)
        outcomes = history.counts(ids).get(end or names[-1])
        passed = outcomes["passed"] if outcomes else 0
    for words in run.tally.unjudged[:10]:
        click.echo(one_line(words), err=True)
    if run.tally.unjudged:
        ctx.exit(ExitCode.ERROR)
    ctx.exit(ExitCode.PASS if passed else ExitCode.FAIL)


def merge(corpus: Path, other: Path) -> str:
    """Take over what models answered, from one corpus into another; gives how much in words. Raises EnvCraftError."""
    from envcraft_llm.endpoint.journal import merge as take

    taken = take(corpus, other)
    return plural(taken, "answer") if taken else ""


def _at_once(count: int, workers: int, chosen: ModelChoice) -> int:
    """How many concepts are under way: enough that neither the endpoint nor the cores wait for the other."""
    if chosen.batch:
        # A batch is what is asked at the same time.
        return count
    return _EACH_CORE * workers + (0 if is_demo(chosen) else _EACH_REQUEST * chosen.max_concurrency)


async def _through(run: Run, ids: Sequence[str], bench: Workbench, model: Model, at_once: int) -> None:
    """Raises EnvCraftError."""
    try:
        await run.run(ids, bench, at_once)
    except OSError as error:
        where = error.filename or "the corpus"
        raise EnvCraftError(f"{where} cannot be written: {error.strerror or error}") from None
    finally:
        await model.close()


def _cases(count: int | None, seed: int, chosen: ModelChoice) -> list[Case]:
    """The concepts of the run. Raises UsageError."""
    import msgspec

    from envcraft.stages import Case
    from envcraft_llm.concepts.generation import concepts
    from envcraft_llm.demo_model import SEED, demo_concepts

    if is_demo(chosen):
        if seed != SEED:
            raise UsageError(f"--seed {seed}: the demo has concepts of seed {SEED} alone")
        made = demo_concepts(demo_folder(chosen))[:count]
        if not made:
            raise UsageError(f"{demo_folder(chosen)} holds no answers to replay")
    elif count is None:
        raise UsageError("say how many: --concepts N")
    else:
        made = list(concepts(count, seed))
    return [Case(one.id, one.title, one.text, msgspec.to_builtins(one)) for one in made]


def _opened_store(place: Path) -> Store:
    """Raises UsageError, CorpusBusy, CorpusDamaged."""
    from envcraft.corpus.store import Store, is_corpus

    store = Store(place, write=True) if is_corpus(place) else Store.create(place)
    if store.follows_folder:
        store.close()
        raise UsageError(f"{place} follows a folder; generate into another corpus")
    return store


@contextlib.contextmanager
def _interrupted(run: Run, ids: Sequence[str]) -> Iterator[None]:
    """Say what is kept where a run ends in between."""
    try:
        yield
    except (KeyboardInterrupt, EnvCraftError):
        settled = f"{run.tally.settled:,} of {plural(len(ids), 'concept')}"
        click.echo(f"{settled} are settled and kept; the same command goes on from there", err=True)
        raise


def _summary(history: History, stages: Sequence[Stage], ids: Sequence[str], accounts: Accounts | None) -> None:
    from .tables import cost_lines, rows, stage_table, yield_lines

    for line in stage_table(rows(history, stages, ids)):
        click.echo(line)
    for title, lines in (("Attempts", yield_lines(history.yields(ids))), ("Requests", cost_lines(accounts))):
        if lines:
            click.echo(f"\n{title}")
        for line in lines:
            click.echo(f"  {line}")
