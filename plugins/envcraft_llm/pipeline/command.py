"""``envcraft generate --concepts N``: takes concepts through all stages into a corpus."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from envcraft.cli.options import sandbox_options
from envcraft.cli.signals import uninterrupted
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.text import one_line, plural
from envcraft_llm.endpoint import ModelSettings, model_options

from .options import (
    check_demo_games,
    check_model,
    check_stage_name,
    create_model,
    demo_answers,
    driver_for_generated,
    enabled_stages,
    is_demo,
    judge_executor,
    model_for,
    offered_stages,
)

if TYPE_CHECKING:
    from envcraft.corpus.store import Store
    from envcraft.generation.history import History
    from envcraft.generation.stages import ConceptState, Stage, StageContext
    from envcraft_llm.endpoint.usage import UsageTracker
    from envcraft_llm.model import Model

    from .runner import PipelineRunner

#: The default corpus of the demo.
_DEMO_CORPUS = "envcraft-demo"
#: Concepts in progress per judging core, and per request in flight.
_PER_CORE, _PER_REQUEST = 4, 2
#: Number of judging errors printed at the end.
_ERRORS = 10


@click.command(name="concepts")
@click.option(
    "--concepts", type=click.IntRange(1), metavar="N", help="Take N concepts through all stages, with language models."
)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0)
@click.option("--corpus", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--with", "optional", metavar="STAGE", multiple=True, help="Also run this optional stage, such as elaboration."
)
@click.option("--from", "first", metavar="STAGE", help="Start at this stage, with concepts that have reached it.")
@click.option("--until", "last", metavar="STAGE", help="Stop after this stage.")
@click.option("--offline", is_flag=True, help="Send no request: replay completions from the corpus's journal.")
@model_options
@click.option(
    "--budget",
    type=click.Choice(list(BUDGETS)),
    help="Budget of the checks.  [default: standard; quick for --model demo]",
)
@sandbox_options()
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
    model_settings: ModelSettings,
    budget: str | None,
    sandbox: str,
    runtime: str | None,
    require_isolation: str | None,
    workers: int | None,
) -> None:
    """Take concepts through all stages into a corpus."""
    offered = offered_stages()
    begin, end, *others = (check_stage_name(name, offered) for name in (first, last, *optional))
    # --from and --until enable an optional stage too.
    stages = enabled_stages(offered, {begin, end, *others})
    names = [stage.name for stage in stages]
    if begin and end and names.index(begin) > names.index(end):
        raise UsageError(f"--from {begin} comes after --until {end}; the stages are {', '.join(names)}")
    if corpus is None and not is_demo(model_settings):
        raise UsageError("name the corpus with --corpus DIR")
    corpus = corpus or Path(_DEMO_CORPUS)
    with uninterrupted():
        states = _states(concepts, seed, model_settings)
        check_model(model_settings, corpus, offline)
    ids = [state.concept for state in states]
    with contextlib.ExitStack() as stack:
        driver = driver_for_generated(sandbox, require_isolation, runtime)
        stack.callback(driver.close)
        if is_demo(model_settings):
            check_demo_games(model_settings, driver)
        with uninterrupted():
            from envcraft.generation.history import History

            from .context import CorpusContext
            from .progress import ProgressDisplay
            from .runner import PipelineRunner
            from .tables import rows

            budget = budget or ("quick" if is_demo(model_settings) else "standard")
            judges, verdict_settings = judge_executor(driver, budget, workers)
        stack.enter_context(judges)
        store = stack.enter_context(_open_store(corpus))
        history = History(store, verdict_settings)
        # Before the concepts are stored, since it may raise.
        model, usage = create_model(model_settings, store.root, offline)
        history.keep_concepts(states)
        runner = PipelineRunner(history, stages, begin, end)
        context = CorpusContext(
            history, model, judges, lambda stage: model_for(model_settings, stage), model_settings.effort
        )
        display = ProgressDisplay(rows(history, stages, ids), runner.progress, usage)
        runner.on_change = display.update
        concurrency = _concurrency(len(ids), judges.workers, model_settings)
        try:
            # The display ends first, since _resumable prints.
            with _resumable(runner, ids), display:
                asyncio.run(_run(runner, ids, context, model, concurrency))
        finally:
            _print_summary(history, stages, ids, usage)
        if is_demo(model_settings):
            click.echo(f"\nThe environments are in the corpus {corpus}. Next: envcraft corpus list {corpus}")
        outcomes = history.counts(ids).get(end or names[-1])
        passed = outcomes["passed"] if outcomes else 0
    for error in runner.progress.errors[:_ERRORS]:
        click.echo(one_line(error), err=True)
    if runner.progress.errors:
        ctx.exit(ExitCode.ERROR)
    ctx.exit(ExitCode.PASS if passed else ExitCode.FAIL)


def merge(corpus: Path, other: Path) -> str:
    """Copy the journal of one corpus into another, and return how much was copied in words. Raises EnvCraftError."""
    from envcraft_llm.endpoint.journal import merge as merge_journals

    count = merge_journals(corpus, other)
    return plural(count, "answer") if count else ""


def _concurrency(count: int, workers: int, settings: ModelSettings) -> int:
    """The number of concepts in progress that keeps both the endpoint and the cores busy."""
    if settings.batch:
        # One batch holds the requests of all concepts.
        return count
    return _PER_CORE * workers + (0 if is_demo(settings) else _PER_REQUEST * settings.max_concurrency)


async def _run(
    runner: PipelineRunner, ids: Sequence[str], context: StageContext, model: Model, concurrency: int
) -> None:
    """Raises EnvCraftError."""
    try:
        await runner.run(ids, context, concurrency)
    except OSError as error:
        where = error.filename or "the corpus"
        raise EnvCraftError(f"{where} cannot be written: {error.strerror or error}") from None
    finally:
        await model.close()


def _states(count: int | None, seed: int, settings: ModelSettings) -> list[ConceptState]:
    """The concepts of the run. Raises UsageError."""
    import msgspec

    from envcraft.generation.stages import ConceptState
    from envcraft_llm.concepts.generation import concepts
    from envcraft_llm.recorded import SEED, recorded_concepts

    if is_demo(settings):
        if seed != SEED:
            raise UsageError(f"--seed {seed}: the demo has concepts of seed {SEED} only")
        chosen = recorded_concepts(demo_answers(settings))[:count]
        if not chosen:
            raise UsageError(f"{demo_answers(settings)} holds no recorded answers")
    elif count is None:
        raise UsageError("give the number of concepts with --concepts N")
    else:
        chosen = list(concepts(count, seed))
    return [ConceptState(one.id, one.title, one.text, msgspec.to_builtins(one)) for one in chosen]


def _open_store(path: Path) -> Store:
    """Raises UsageError, CorpusBusy, CorpusDamaged."""
    from envcraft.corpus.store import Store, is_corpus

    store = Store(path, write=True) if is_corpus(path) else Store.create(path)
    if store.follows_folder:
        store.close()
        raise UsageError(f"{path} follows a folder; generate into another corpus")
    return store


@contextlib.contextmanager
def _resumable(runner: PipelineRunner, ids: Sequence[str]) -> Iterator[None]:
    """Print what is stored if the run is interrupted."""
    try:
        yield
    except (KeyboardInterrupt, EnvCraftError):
        settled = f"{runner.progress.settled:,} of {plural(len(ids), 'concept')}"
        click.echo(f"{settled} are settled and stored; run the same command again to continue", err=True)
        raise


def _print_summary(history: History, stages: Sequence[Stage], ids: Sequence[str], usage: UsageTracker | None) -> None:
    from .tables import rows, stage_table, usage_lines, yield_lines

    for line in stage_table(rows(history, stages, ids)):
        click.echo(line)
    for title, lines in (("Attempts", yield_lines(history.yields(ids))), ("Requests", usage_lines(usage))):
        if lines:
            click.echo(f"\n{title}")
        for line in lines:
            click.echo(f"  {line}")
