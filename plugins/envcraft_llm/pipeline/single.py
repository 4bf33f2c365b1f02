"""``envcraft repair FILE`` and ``envcraft privileged FILE``: one stage on one file, without a corpus of one's own."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from envcraft.budget import BUDGETS
from envcraft.cli import Sharing, uninterrupted
from envcraft.commands.choices import where_options
from envcraft.errors import ExitCode, UsageError
from envcraft.reports import one_line, plural
from envcraft_llm.endpoint import ModelChoice, model_options

from .options import driver_for_generated, is_demo, judges, named, opened

if TYPE_CHECKING:
    from envcraft.stages import Case, Outcome, Stage

_FILE = click.argument("file", metavar="FILE", type=click.Path(exists=True, dir_okay=False, path_type=Path))
_CLASS = click.option("--class", "env_class", metavar="NAME", default="", help="The class, where the file has several.")
_BRIEF = click.option(
    "--brief",
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="The design document that the file is of.",
)
_OUTPUT = click.option("--output", metavar="FILE", type=click.Path(dir_okay=False, path_type=Path))
_JOURNAL = click.option(
    "--journal",
    metavar="PATH",
    type=click.Path(path_type=Path),
    help="Keeps what was answered, so that nothing is asked twice: a file such as answers.sqlite, or a folder for one.",
)
_BUDGET = click.option("--budget", type=click.Choice(list(BUDGETS)), default="standard", show_default=True)
#: What stands in the place of a brief that nobody has written.
_NO_BRIEF = "There is no design document: the docstrings and the constants of the file say what is meant."


@click.command(cls=Sharing)
@_FILE
@_BRIEF
@_CLASS
@_OUTPUT
@_JOURNAL
@model_options
@_BUDGET
@where_options()
@click.pass_context
def repair(ctx: click.Context, /, file: Path, output: Path | None, **options: Any) -> None:
    """Judge a file by all checks, and have a model repair what they find, up to three times.

    What comes of it is written to --output, or to standard output. A repair that makes the game less is refused.

    \b
    Exit status: 0 it passes, or does now    1 it could not be repaired
                 2 wrong use                 3 it could not be judged, or no model answers
    """
    from envcraft_llm.stages.repair import Repair

    _writable(output)
    case, outcome = _alone(Repair(), file, **options)
    best = case.best
    assert best is not None
    for attempt in case.attempts:
        _tell(f"attempt {attempt.number}", attempt.gutted, [*_findings(attempt.report)])
    _finish(ctx, outcome, best.source, output)


@click.command(cls=Sharing)
@_FILE
@_BRIEF
@_CLASS
@_OUTPUT
@_JOURNAL
@model_options
@_BUDGET
@where_options()
@click.pass_context
def privileged(ctx: click.Context, /, file: Path, output: Path | None, **options: Any) -> None:
    """Have a model write a policy that reads the state of a game, and see whether it wins.

    A policy that wins is written to --output, or to standard output; `envcraft validate FILE --policy POLICY` plays it.

    \b
    Exit status: 0 the policy wins, or the checker's own search does    1 neither does, or the game is trivial
                 2 wrong use                                            3 it could not be judged, or no model answers
    """
    from envcraft_llm.stages.privileged import Privileged

    _writable(output)
    case, outcome = _alone(Privileged(), file, judged=True, **options)
    for policy in case.policies:
        _tell(f"policy {policy.number}", f"wins {policy.wins} of {policy.episodes}", [policy.fault])
    if outcome.result == "passed" and outcome.facts["policy"] is None:
        words = "no policy wins, the checker's own search does, and nothing is written"
        outcome = msgspec.structs.replace(outcome, reason=words)
    best = max(case.policies, key=lambda policy: policy.wins, default=None)
    _finish(ctx, outcome, best.source if best is not None and best.wins else "", output)


def _alone(
    stage: Stage,
    file: Path,
    *,
    brief: Path | None,
    env_class: str,
    journal: Path | None,
    chosen: ModelChoice,
    budget: str,
    sandbox: str,
    runtime: str | None,
    require_isolation: str | None,
    workers: int | None,
    judged: bool = False,
) -> tuple[Case, Outcome]:
    """Run a stage on one file, in a corpus that is gone afterwards. With `judged`, the file is judged before.

    Raises UsageError, SandboxUnavailable, EnvCraftError.
    """
    if is_demo(chosen):
        raise UsageError("--model demo answers for its own concepts alone; name an endpoint with --base-url")
    source, text = _text(file), _text(brief) if brief is not None else _NO_BRIEF
    with contextlib.ExitStack() as stack:
        driver = driver_for_generated(sandbox, require_isolation, runtime)
        stack.callback(driver.close)
        with uninterrupted():
            # Not at the start of every command.
            import asyncio
            import tempfile

            from envcraft.corpus.history import History
            from envcraft.corpus.store import Store
            from envcraft.errors import EnvCraftError
            from envcraft.stages import Attempt, Case
            from envcraft_llm.model import ModelFailure

            from .bench import Bench

            judging, settings = judges(driver, budget, workers)
        stack.enter_context(judging)
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="envcraft-"))
        store = stack.enter_context(Store.create(Path(folder, "corpus")))
        history = History(store, settings)
        case = Case(hashlib.sha256(source.encode()).hexdigest()[:16], file.stem, file.stem, brief=text)
        history.keep_concepts([case])
        model, _ = opened(chosen, journal)
        bench = Bench(history, model, judging, lambda name: named(chosen, name), chosen.effort)

        async def through() -> Outcome:
            first = Attempt(0, source, env_class)
            try:
                if judged:
                    await bench.judge(case, first)
                bench.keep_attempt(case, first)
                return await stage.run(case, bench)
            except ModelFailure as failure:
                raise EnvCraftError(f"the model gave no usable answer ({failure.kind}): {failure}") from None
            finally:
                await model.close()

        return case, asyncio.run(through())


def _text(file: Path) -> str:
    """Raises UsageError."""
    try:
        return file.read_text("utf-8")
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{file} is no UTF-8 text") from None


def _findings(report: Any) -> Iterator[str]:
    from envcraft_llm.findings import findings, lines_of

    return lines_of(findings(report))


def _tell(what: str, words: str, lines: list[str]) -> None:
    counted = plural(len(lines), "finding") if lines else "no finding"
    click.echo(f"{what}: {one_line(words) or counted}", err=True)
    for line in lines:
        if line:
            click.echo(f"  {one_line(line)}", err=True)


def _writable(output: Path | None) -> None:
    """Look whether a file can be written before anything is paid for. Raises UsageError."""
    if output is None:
        return
    place = output if output.exists() else output.parent
    if not place.exists():
        raise UsageError(f"--output {output} cannot be written: {place} does not exist")
    if not os.access(place, os.W_OK):
        raise UsageError(f"--output {output} cannot be written: {place} is read-only")


def _finish(ctx: click.Context, outcome: Outcome, source: str, output: Path | None) -> None:
    """Write what came of it, if anything, and end with the status that says so. Raises UsageError."""
    click.echo(f"{outcome.result}  {one_line(outcome.reason)}".rstrip(), err=True)
    if output is None:
        click.echo(source, nl=False)
    elif source:
        try:
            output.write_text(source, "utf-8")
        except OSError as error:
            raise UsageError(f"--output {output} cannot be written: {error.strerror}") from None
    ctx.exit(ExitCode.PASS if outcome.result == "passed" else ExitCode.FAIL)
