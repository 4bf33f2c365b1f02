"""``envcraft repair FILE`` and ``envcraft privileged FILE``: one stage on one file, without a corpus."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from envcraft.cli.configured import PartlyConfigured
from envcraft.cli.options import sandbox_options
from envcraft.cli.signals import uninterrupted
from envcraft.errors import ExitCode, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.text import one_line, plural
from envcraft_llm.endpoint import ModelSettings, model_options

from .options import create_model, driver_for_generated, is_demo, judge_executor, model_for

if TYPE_CHECKING:
    from envcraft.generation.stages import ConceptState, Stage, StageOutcome
    from envcraft.model.verdict import SubjectReport

_FILE = click.argument("file", metavar="FILE", type=click.Path(exists=True, dir_okay=False, path_type=Path))
_CLASS = click.option(
    "--class", "env_class", metavar="NAME", default="", help="Environment class, if the file has several."
)
_BRIEF = click.option(
    "--brief",
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Design document of the game.",
)
_OUTPUT = click.option(
    "--output",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the result to this file.  [default: standard output]",
)
_JOURNAL = click.option(
    "--journal",
    metavar="PATH",
    type=click.Path(path_type=Path),
    help="Store completions, so that no request is sent twice, in a file such as answers.sqlite or in a folder.",
)
_BUDGET = click.option(
    "--budget",
    type=click.Choice(list(BUDGETS)),
    default="standard",
    show_default=True,
    help="Budget of the checks.",
)
#: Takes the place of a brief in the prompts.
_NO_BRIEF = "There is no design document: the docstrings and the constants of the file say what is meant."


@click.command(cls=PartlyConfigured)
@_FILE
@_BRIEF
@_CLASS
@_OUTPUT
@_JOURNAL
@model_options
@_BUDGET
@sandbox_options()
@click.pass_context
def repair(ctx: click.Context, /, file: Path, output: Path | None, **options: Any) -> None:
    """Let a model repair a file.

    The command runs all checks and sends their findings to the model, up to three times. It rejects a degenerate
    repair, which passes by doing less than the file did. It writes the result to --output or to standard output.

    \b
    Exit status: 0 the file passes
                 1 it could not be repaired
                 2 usage error
                 3 it could not be judged, or no model answers
    """
    from envcraft_llm.stages.repair import Repair

    _check_writable(output)
    state, outcome = _run_alone(Repair(), file, **options)
    best = state.best
    assert best is not None
    for attempt in state.attempts:
        _print(f"attempt {attempt.number}", attempt.degenerate, [*_findings(attempt.report)])
    _finish(ctx, outcome, best.source, output)


@click.command(cls=PartlyConfigured)
@_FILE
@_BRIEF
@_CLASS
@_OUTPUT
@_JOURNAL
@model_options
@_BUDGET
@sandbox_options()
@click.pass_context
def privileged(ctx: click.Context, /, file: Path, output: Path | None, **options: Any) -> None:
    """Let a model write a policy that reads the game state.

    The command plays the policy. If the policy wins, the command writes it to --output or to standard output.
    `envcraft validate FILE --policy POLICY` plays the policy again.

    \b
    Exit status: 0 the policy or a search of the checks wins
                 1 neither wins, or the game is trivial
                 2 usage error
                 3 it could not be judged, or no model answers
    """
    from envcraft_llm.stages.privileged import Privileged

    _check_writable(output)
    state, outcome = _run_alone(Privileged(), file, judged=True, **options)
    for policy in state.policies:
        _print(f"policy {policy.number}", f"wins {policy.wins} of {policy.episodes}", [policy.fault])
    if outcome.result == "passed" and outcome.facts["policy"] is None:
        reason = "no policy wins, but the checker's own search does; no policy is written"
        outcome = msgspec.structs.replace(outcome, reason=reason)
    best = max(state.policies, key=lambda policy: policy.wins, default=None)
    _finish(ctx, outcome, best.source if best is not None and best.wins else "", output)


def _run_alone(
    stage: Stage,
    file: Path,
    *,
    brief: Path | None,
    env_class: str,
    journal: Path | None,
    model_settings: ModelSettings,
    budget: str,
    sandbox: str,
    runtime: str | None,
    require_isolation: str | None,
    workers: int | None,
    judged: bool = False,
) -> tuple[ConceptState, StageOutcome]:
    """Run a stage on one file, in a temporary corpus. If `judged` is true, run all checks on the file first.

    Raises UsageError, SandboxUnavailable, EnvCraftError.
    """
    if is_demo(model_settings):
        raise UsageError("--model demo answers for its own concepts only; name an endpoint with --base-url")
    source, text = _read(file), _read(brief) if brief is not None else _NO_BRIEF
    with contextlib.ExitStack() as stack:
        driver = driver_for_generated(sandbox, require_isolation, runtime)
        stack.callback(driver.close)
        with uninterrupted():
            # Imported here because they are slow to import.
            import asyncio
            import tempfile

            from envcraft.corpus.store import Store
            from envcraft.errors import EnvCraftError
            from envcraft.generation.history import History
            from envcraft.generation.stages import Attempt, ConceptState
            from envcraft_llm.model import RequestFailed

            from .context import CorpusContext

            judges, verdict_settings = judge_executor(driver, budget, workers)
        stack.enter_context(judges)
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="envcraft-"))
        store = stack.enter_context(Store.create(Path(folder, "corpus")))
        history = History(store, verdict_settings)
        state = ConceptState(hashlib.sha256(source.encode()).hexdigest()[:16], file.stem, file.stem, brief=text)
        history.keep_concepts([state])
        model, _ = create_model(model_settings, journal)
        context = CorpusContext(
            history, model, judges, lambda name: model_for(model_settings, name), model_settings.effort
        )

        async def run() -> StageOutcome:
            first = Attempt(0, source, env_class)
            try:
                if judged:
                    await context.judge(state, first)
                context.keep_attempt(state, first)
                return await stage.run(state, context)
            except RequestFailed as failure:
                raise EnvCraftError(f"the model gave no usable answer ({failure.kind}): {failure}") from None
            finally:
                await model.close()

        return state, asyncio.run(run())


def _read(file: Path) -> str:
    """Raises UsageError."""
    try:
        return file.read_text("utf-8")
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"{file} is not UTF-8 text") from None


def _findings(report: SubjectReport | None) -> Iterator[str]:
    from envcraft_llm.findings import finding_lines, findings

    return finding_lines(findings(report))


def _print(heading: str, text: str, lines: list[str]) -> None:
    count = plural(len(lines), "finding") if lines else "no finding"
    click.echo(f"{heading}: {one_line(text) or count}", err=True)
    for line in lines:
        if line:
            click.echo(f"  {one_line(line)}", err=True)


def _check_writable(output: Path | None) -> None:
    """Check that the output can be written, before any request is paid for. Raises UsageError."""
    if output is None:
        return
    place = output if output.exists() else output.parent
    if not place.exists():
        raise UsageError(f"--output {output} cannot be written: {place} does not exist")
    if not os.access(place, os.W_OK):
        raise UsageError(f"--output {output} cannot be written: {place} is read-only")


def _finish(ctx: click.Context, outcome: StageOutcome, source: str, output: Path | None) -> None:
    """Write the result, if there is one, and exit with the status of the outcome. Raises UsageError."""
    click.echo(f"{outcome.result}  {one_line(outcome.reason)}".rstrip(), err=True)
    if output is None:
        click.echo(source, nl=False)
    elif source:
        try:
            output.write_text(source, "utf-8")
        except OSError as error:
            raise UsageError(f"--output {output} cannot be written: {error.strerror}") from None
    ctx.exit(ExitCode.PASS if outcome.result == "passed" else ExitCode.FAIL)
