"""``envcraft replay``: run the reproductions of a report again."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from envcraft.cli import completion
from envcraft.cli.commands.validate import read_wrappers
from envcraft.cli.options import runtime_option
from envcraft.cli.play.recorded import Played
from envcraft.contracts.lookup import contract_named
from envcraft.errors import EnvCraftError, ExitCode, Skip, UsageError
from envcraft.files import atomic_write
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver, driver_for
from envcraft.judging.selection import all_checks, default_checks, driver_named
from envcraft.model.project import configured, with_project
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.target import Kind, Target, kind_of, read_target
from envcraft.model.verdict import SCHEMA, Finding, Report, Repro, Severity, SubjectReport
from envcraft.registry import did_you_mean
from envcraft.reports.summary import Numbered, numbered, repro_words
from envcraft.text import one_line, plural

if TYPE_CHECKING:
    from envcraft.judging.engine import Plan
    from envcraft.judging.subject import Subject

_MAX_REPORT = 256 * 1024**2
_MAX_ACTIONS = 100_000
_GIF_FRAMES = 1_001
_EXAMPLE = '{"seed": 0, "actions": [[0, 0, 0]]}'
#: Pixels of the longer side, about: small frames are enlarged.
_GIF_SIDE = 336


@click.command()
@click.argument("report", metavar="REPORT.json|TARGET", shell_complete=completion.files)
@click.option(
    "--finding", "number", type=click.IntRange(1), metavar="K", help="Replay only the K-th finding of the report."
)
@click.option(
    "--gif", metavar="FILE", shell_complete=completion.files, help="Write the finding's episode as an animated GIF."
)
@click.option(
    "--repro", metavar="JSON", help="Play this reproduction of a TARGET, as envcraft.testing and reports write it."
)
@click.option(
    "--contract",
    default="arcade",
    show_default=True,
    metavar="NAME",
    shell_complete=completion.contracts,
    help="The contract of the TARGET of --repro.",
)
@click.option("--class", "env_class", metavar="NAME", help="The class of the TARGET of --repro, if it has several.")
@click.option(
    "--sandbox",
    default="auto",
    show_default=True,
    metavar="NAME",
    shell_complete=completion.sandboxes,
    help="The sandbox that runs the environments.",
)
@runtime_option
@click.option("--anyway", is_flag=True, help="Replay even if the source has changed since the report.")
@click.pass_context
def replay(
    ctx: click.Context,
    report: str,
    number: int | None,
    gif: str | None,
    repro: str | None,
    contract: str,
    env_class: str | None,
    sandbox: str,
    runtime: str | None,
    anyway: bool,
) -> None:
    """Run the reproductions of a report, or one given by --repro.

    Each reproduction runs in new workers, and the command reports whether the defect shows again. With --repro, it
    reports how the episode ends, and the defects that this episode alone shows.

    \b
    Exit status: 0 every defect shows again
                 1 some do not
                 2 usage error
                 3 some could not be replayed
    With --repro: 0 the episode has no error
                  1 the episode shows an error
    """
    if gif is not None and Path(gif).suffix.lower() not in ("", ".gif"):
        raise UsageError(f"--gif {gif} is an animated GIF; end its name with .gif")
    if repro is not None:
        with contextlib.closing(driver_named(sandbox, runtime=runtime)) as driver:
            ctx.exit(_replay_target(report, env_class, read_repro(repro), contract, driver, gif))
    read = read_report(report)
    chosen = choose_findings(read, number)
    if not chosen:
        click.echo("The report has no finding to replay.")
        return
    if gif and len(chosen) > 1:
        raise UsageError(f"--gif shows one finding: choose one of {len(chosen)} with --finding K")
    statuses: set[ExitCode] = set()
    with contextlib.closing(driver_named(sandbox, runtime=runtime)) as driver:
        checks = {check.name: check for check in [*all_checks(), Played()]}
        for subject_report in read.reports:
            findings = [item for item in chosen if item.subject is subject_report]
            if findings:
                plan = _plan(read, driver, subject_report, list(checks.values()))
                statuses.update(_replay_subject(plan, report, findings, checks, anyway, gif))
    ctx.exit(max(statuses))


def read_report(path: str) -> Report:
    """Read a report that ``validate --format json`` wrote. Raises UsageError."""
    hint = "write one with `envcraft validate TARGET --format json --output report.json`"
    try:
        with open(path, "rb") as stream:
            data = stream.read(_MAX_REPORT + 1)
    except OSError as error:
        raise UsageError(f"the report {path} cannot be read ({error.strerror}); {hint}") from None
    if len(data) > _MAX_REPORT:
        raise UsageError(f"{path} is larger than any report; {hint}")
    try:
        report = msgspec.json.decode(data, type=Report)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        if path.endswith(".py"):
            raise UsageError(
                f"{path} is not a report but a Python file; {hint}, or play one episode with --repro"
            ) from None
        raise UsageError(f"{path} is not a report ({one_line(error)}); {hint}") from None
    if report.schema != SCHEMA:
        raise UsageError(f"{path} has schema {report.schema}; this version of EnvCraft reads schema {SCHEMA}")
    for item in numbered(report):
        if len(item.finding.repro.actions) > _MAX_ACTIONS or not 0 <= item.finding.repro.seed < 2**63:
            raise UsageError(
                f"{path}: the reproduction of finding {item.number} has an invalid seed or too many actions"
            )
    return report


def read_repro(text: str) -> Repro:
    """Read a reproduction. Raises UsageError."""
    try:
        read = msgspec.json.decode(text, type=Repro)
        Conditions.from_json(read.conditions)
    except (msgspec.DecodeError, UnicodeEncodeError, RecursionError) as error:
        raise UsageError(f"--repro is not a reproduction ({one_line(error)}), such as {_EXAMPLE}") from None
    if len(read.actions) > _MAX_ACTIONS or not 0 <= read.seed < 2**63:
        raise UsageError("--repro has an invalid seed or too many actions")
    for kind, given, known in (
        ("field", msgspec.json.decode(text), Repro.__struct_fields__),
        ("condition", read.conditions, Conditions.__struct_fields__),
    ):
        for name in given:
            if name not in known:
                raise UsageError(f"--repro has no {kind} {did_you_mean(name, known)}")
    return read


def _replay_target(
    path: str, env_class: str | None, repro: Repro, contract: str, driver: Driver, gif: str | None
) -> ExitCode:
    """Play a reproduction of a target, and print how it ends and what single episodes show."""
    from envcraft.cli.play.game import result
    from envcraft.environments.targets import resolve
    from envcraft.judging.engine import Plan, open_subject, run_check
    from envcraft.spaces.validation import validate_action

    targets = resolve(path, env_class)
    if len(targets) != 1:
        raise UsageError(f"{path} holds {len(targets)} environments; name the file of one")
    plan = Plan(
        targets, contract_named(contract), driver_for(driver, targets), default_checks(), BUDGETS["quick"], repro.seed
    )
    with open_subject(plan, targets[0]) as subject:
        if subject.load().trace.fault is None:
            for action in repro.actions:
                if wrong := validate_action(subject.action_space, action):
                    raise UsageError(f"--repro: {one_line(wrong)}")
        conditions = Conditions.from_json(repro.conditions)
        trace = subject.rollout(Rollout(repro.seed, repro.actions, conditions, player="these actions"))
        words = repro_words(repro)
        click.echo(f"{one_line(path)}: {words}: {result(trace)}")
        status = ExitCode.PASS
        for check in plan.checks:
            if check.gate or type(check).find is not Check.find:
                for finding in run_check(check, subject, None if check.gate else trace).findings:
                    line = f":{finding.line}" if finding.line else ""
                    click.echo(f"  {finding.code} {one_line(subject.target.path)}{line}: {one_line(finding.message)}")
                    if finding.severity is Severity.ERROR:
                        status = ExitCode.FAIL
        if gif:
            write_gif(subject, Finding("", Severity.WARNING, "", repro=repro), gif)
    return status


def choose_findings(report: Report, number: int | None) -> list[Numbered]:
    """Return all findings, or the one with this number. Raises UsageError if it does not exist."""
    found = list(numbered(report))
    if number is None:
        return found
    if number > len(found):
        raise UsageError(f"there is no finding {number}: the report has {len(found)}")
    return [found[number - 1]]


def _plan(report: Report, driver: Any, subject: SubjectReport, checks: list[Check]) -> Plan:
    """Restore the plan of the report, without targets."""
    from envcraft.demonstrations.player import policy_named
    from envcraft.judging.engine import Plan

    if report.budget not in BUDGETS:
        raise UsageError(f"the report names the unknown budget {one_line(report.budget)}")
    policy = policy_named(subject.policy) if subject.policy else None
    return Plan([], contract_named(report.contract), driver, checks, BUDGETS[report.budget], report.seed, policy)


def _replay_subject(
    plan: Plan, report: str, chosen: list[Numbered], checks: dict[str, Check], anyway: bool, gif: str | None
) -> Iterator[ExitCode]:
    """Replay the findings of one subject, which share its workers and rollouts."""
    from envcraft.judging.engine import open_subject

    recorded = chosen[0].subject
    try:
        target = _target(recorded, report)
    except UsageError as error:
        yield _could_not(chosen, str(error))
        return
    changed = f"{one_line(recorded.file)} has changed since the report; replay it with --anyway"
    if target.kind is Kind.SOURCE and not anyway and _digests(target) != _recorded_digests(recorded):
        yield _could_not(chosen, changed)
        return
    plan = msgspec.structs.replace(plan, driver=driver_for(plan.driver, [target]))
    for several in (False, True):
        # A finding about several classes shows only if none of them is selected.
        findings = [item for item in chosen if (item.finding.code == "EC006") is several]
        if findings:
            picked = msgspec.structs.replace(target, env_class=None if several else recorded.env_class)
            with open_subject(plan, picked) as subject:
                if target.kind is not Kind.SOURCE and not anyway:
                    # Only loading shows which file an installed class comes from.
                    subject.load()
                    if subject.source_sha256 != recorded.source_sha256:
                        yield _could_not(findings, changed)
                        continue
                for item in findings:
                    yield _replay(subject, item, checks.get(item.check.check))
                    if gif:
                        write_gif(subject, item.finding, gif)


def _digests(target: Target) -> tuple[str, dict[str, str]]:
    return target.sha256, target.project.digests if target.project is not None else {}


def _recorded_digests(recorded: SubjectReport) -> tuple[str, dict[str, str]]:
    return recorded.source_sha256, recorded.project.files if recorded.project is not None else {}


def _target(recorded: SubjectReport, report: str) -> Target:
    """Restore a report's target. Raises UsageError if its file cannot be read or its kind is wrong."""
    if recorded.kind is Kind.SOURCE:
        target = _with_project(read_target(_find(recorded.path, report)), recorded)
    elif kind_of(recorded.path) is recorded.kind:
        target = Target(recorded.path, kind=recorded.kind)
    else:
        raise UsageError(f"{one_line(recorded.path)} is not a {recorded.kind}")
    target = configured(target, recorded.kwargs, read_wrappers(tuple(recorded.wrappers)))
    return msgspec.structs.replace(target, path=recorded.path)


def _with_project(target: Target, recorded: SubjectReport) -> Target:
    """Give a file the files of its project if it was judged with some."""
    if recorded.project is None:
        return target
    root = Path(recorded.project.root).absolute()
    # A module that the user named has one folder that imports start from.
    named = not recorded.project.imports and Path(target.path).absolute().is_relative_to(root)
    return with_project(target, root if named else None)


def _find(path: str, report: str) -> str:
    """Look a relative path up in the working directory, then in the report's folder."""
    beside = Path(report).parent / path
    return str(beside) if not os.path.exists(path) and beside.exists() else path


def _replay(subject: Subject, item: Numbered, check: Check | None) -> ExitCode:
    if check is None:
        return _could_not([item], f"the check {one_line(item.check.check)} is not installed")
    try:
        found = check.confirm(subject, item.finding)
    except Skip as skip:
        return _could_not([item], str(skip))
    except EnvCraftError as error:
        return _could_not([item], str(error))
    except Exception as error:
        return _could_not([item], f"the check raised {type(error).__name__}: {one_line(error)}")
    if found is None:
        click.echo(f"{_label(item)}: not reproduced: {one_line(item.finding.message)}")
        return ExitCode.FAIL
    click.echo(f"{_label(item)}: reproduced: {one_line(found.message)}")
    return ExitCode.PASS


def _label(item: Numbered) -> str:
    line = f":{item.finding.line}" if item.finding.line else ""
    return f"#{item.number} {item.finding.code} {one_line(item.subject.path)}{line}"


def _could_not(items: list[Numbered], reason: str) -> ExitCode:
    for item in items:
        click.echo(f"{_label(item)}: could not be replayed: {one_line(reason)}")
    return ExitCode.ERROR


def write_gif(subject: Subject, finding: Finding, path: str) -> None:
    """Write the frames of a finding's reproduction as an animated GIF, enlarged. Raises UsageError."""
    from PIL import Image

    from envcraft.judging.frame_renderer import frames_of, rgb, with_frames

    try:
        conditions = with_frames(subject, Conditions.from_json(finding.repro.conditions))
        rollout = Rollout(finding.repro.seed, finding.repro.actions, conditions, player="replay", keep=_GIF_FRAMES)
        frames = [frame for kept in frames_of(subject.rollout(rollout)) if (frame := rgb(kept)) is not None]
    except Skip as skip:
        raise UsageError(f"this finding has no picture: {skip}") from None
    except msgspec.ValidationError as error:
        raise UsageError(f"the report's conditions are invalid: {error}") from None
    if not frames:
        raise UsageError("this finding has no picture: its episode gives no frames")
    scale = max(_GIF_SIDE // max(frames[0].shape[:2]), 1)
    pictures = [
        Image.fromarray(frame).resize((frame.shape[1] * scale, frame.shape[0] * scale), Image.Resampling.NEAREST)
        for frame in frames
    ]
    try:
        with atomic_write(path) as stream:
            pictures[0].save(stream, save_all=True, append_images=pictures[1:], duration=40, loop=0, format="GIF")
    except OSError as error:
        raise UsageError(f"--gif {path} cannot be written: {error.strerror or error}") from None
    click.echo(f"wrote {path}: {plural(len(pictures), 'frame')}", err=True)
