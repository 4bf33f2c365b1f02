"""``envcraft replay``: run the reproductions of a report again."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from envcraft.budget import BUDGETS
from envcraft.check import Check, Skip
from envcraft.errors import EnvCraftError, ExitCode, UsageError
from envcraft.playing.recorded import Played
from envcraft.reports import one_line
from envcraft.sandbox import driver_for
from envcraft.target import Kind, Target, kind_of, read_target
from envcraft.verdict import SCHEMA, CheckReport, Finding, Report, SubjectReport

from .choices import all_checks, contract_named, driver_named, runtime_option
from .validate import read_wrappers

if TYPE_CHECKING:
    from envcraft.engine import Plan
    from envcraft.subject import Subject

_MAX_REPORT = 256 * 1024**2
_MAX_ACTIONS = 100_000
_GIF_FRAMES = 1_001
#: Pixels of the longer side, about: small frames are enlarged.
_GIF_SIDE = 336


@dataclass(frozen=True)
class Numbered:
    """A finding with its number in the report."""

    number: int
    subject: SubjectReport
    check: CheckReport
    finding: Finding

    def __str__(self) -> str:
        line = f":{self.finding.line}" if self.finding.line else ""
        return f"#{self.number} {self.finding.code} {one_line(self.subject.path)}{line}"


@click.command()
@click.argument("report", metavar="REPORT.json")
@click.option("--finding", "number", type=click.IntRange(1), metavar="K", help="Only the K-th finding of the report.")
@click.option("--gif", metavar="FILE", help="Write the finding's episode as an animated picture.")
@click.option("--sandbox", default="auto", show_default=True, metavar="NAME", help="Where the environments run.")
@runtime_option
@click.option("--anyway", is_flag=True, help="Replay even where the source has changed since the report.")
@click.pass_context
def replay(
    ctx: click.Context,
    report: str,
    number: int | None,
    gif: str | None,
    sandbox: str,
    runtime: str | None,
    anyway: bool,
) -> None:
    """Run the reproductions in a report again, each in fresh workers, and say whether the defect shows.

    \b
    Exit status: 0 all show again    1 some do not
                 2 wrong use         3 some could not be replayed
    """
    read = read_report(report)
    chosen = choose_findings(read, number)
    if not chosen:
        click.echo("The report has no finding: there is nothing to replay.")
        return
    if gif and len(chosen) > 1:
        raise UsageError(f"--gif shows one finding: choose one of {len(chosen)} with --finding K")
    if gif:
        _import_pillow()
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
    """Read what ``validate --format json`` wrote. Raises UsageError."""
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
        raise UsageError(f"{path} is no report ({one_line(error)}); {hint}") from None
    if report.schema != SCHEMA:
        raise UsageError(f"{path} has schema {report.schema}, and this version of EnvCraft reads schema {SCHEMA}")
    for item in _all_findings(report):
        if len(item.finding.repro.actions) > _MAX_ACTIONS or not 0 <= item.finding.repro.seed < 2**63:
            raise UsageError(f"{path}: the reproduction of finding {item.number} has no sensible seed or actions")
    return report


def choose_findings(report: Report, number: int | None) -> list[Numbered]:
    """All findings, or the one with this number. Raises UsageError where there is none."""
    found = list(_all_findings(report))
    if number is None:
        return found
    if number > len(found):
        raise UsageError(f"there is no finding {number}: the report has {len(found)}")
    return [found[number - 1]]


def _all_findings(report: Report) -> Iterator[Numbered]:
    number = 0
    for subject in report.reports:
        for check in subject.checks:
            for finding in check.findings:
                number += 1
                yield Numbered(number, subject, check, finding)


def _plan(report: Report, driver: Any, subject: SubjectReport, checks: list[Check]) -> Plan:
    """The plan under which the report was made, but for the targets."""
    from envcraft.engine import Plan
    from envcraft.target import read_policy

    if report.budget not in BUDGETS:
        raise UsageError(f"the report names the budget {one_line(report.budget)}, which there is not")
    policy = read_policy(subject.policy) if subject.policy else None
    return Plan([], contract_named(report.contract), driver, checks, BUDGETS[report.budget], report.seed, policy)


def _replay_subject(
    plan: Plan, report: str, chosen: list[Numbered], checks: dict[str, Check], anyway: bool, gif: str | None
) -> Iterator[ExitCode]:
    """Replay the findings of one subject, a subject's workers and rollouts shared among them."""
    from envcraft.engine import open_subject

    told = chosen[0].subject
    try:
        target = _target(told, report)
    except UsageError as error:
        yield _could_not(chosen, str(error))
        return
    changed = f"{one_line(told.file)} has changed since the report; --anyway replays all the same"
    if target.kind is Kind.SOURCE and target.sha256 != told.source_sha256 and not anyway:
        yield _could_not(chosen, changed)
        return
    plan = msgspec.structs.replace(plan, driver=driver_for(plan.driver, [target]))
    for several in (False, True):
        # A finding about several classes shows only where none of them is picked.
        findings = [item for item in chosen if (item.finding.code == "EC006") is several]
        if findings:
            picked = msgspec.structs.replace(target, env_class=None if several else told.env_class)
            with open_subject(plan, picked) as subject:
                if target.kind is not Kind.SOURCE and not anyway:
                    # Which file an installed class comes from is known once it is loaded.
                    subject.load()
                    if subject.source_sha256 != told.source_sha256:
                        yield _could_not(findings, changed)
                        continue
                for item in findings:
                    yield _replay(subject, item, checks.get(item.check.check))
                    if gif:
                        write_gif(subject, item.finding, gif)


def _target(told: SubjectReport, report: str) -> Target:
    """The target that a report is about. Raises UsageError where its file cannot be read, or makes no sense."""
    if told.kind is Kind.SOURCE:
        source = read_target(_find(told.path, report)).source
    elif kind_of(told.path) is told.kind:
        source = b""
    else:
        raise UsageError(f"{one_line(told.path)} is no {told.kind}")
    return Target(told.path, source, None, told.kind, told.kwargs, read_wrappers(tuple(told.wrappers)))


def _find(path: str, report: str) -> str:
    """A report's relative paths count from the working directory, else from the report's folder."""
    beside = Path(report).parent / path
    return str(beside) if not os.path.exists(path) and beside.exists() else path


def _replay(subject: Subject, item: Numbered, check: Check | None) -> ExitCode:
    if check is None:
        return _could_not([item], f"there is no check {one_line(item.check.check)} here")
    try:
        found = check.confirm(subject, item.finding)
    except Skip as skip:
        return _could_not([item], str(skip))
    except EnvCraftError as error:
        return _could_not([item], str(error))
    except Exception as error:
        return _could_not([item], f"the check broke: {type(error).__name__}: {one_line(error)}")
    if found is None:
        click.echo(f"{item}: not reproduced: {one_line(item.finding.message)}")
        return ExitCode.FAIL
    click.echo(f"{item}: reproduced: {one_line(found.message)}")
    return ExitCode.PASS


def _could_not(items: list[Numbered], reason: str) -> ExitCode:
    for item in items:
        click.echo(f"{item}: could not be replayed: {one_line(reason)}")
    return ExitCode.ERROR


def write_gif(subject: Subject, finding: Finding, path: str) -> None:
    """Write the frames of a finding's reproduction as an animated GIF, enlarged. Raises UsageError."""
    from envcraft.frames import rgb, seen, sighted
    from envcraft.rollout import Conditions, Rollout

    image = _import_pillow()
    try:
        conditions = sighted(subject, Conditions.from_json(finding.repro.conditions))
        rollout = Rollout(finding.repro.seed, finding.repro.actions, conditions, player="replay", keep=_GIF_FRAMES)
        frames = [frame for kept in seen(subject.rollout(rollout)) if (frame := rgb(kept)) is not None]
    except Skip as skip:
        raise UsageError(f"this finding has no picture: {skip}") from None
    except msgspec.ValidationError as error:
        raise UsageError(f"the report's conditions make no sense: {error}") from None
    if not frames:
        raise UsageError("this finding has no picture: its episode gives no frames")
    scale = max(_GIF_SIDE // max(frames[0].shape[:2]), 1)
    pictures = [
        image.fromarray(frame).resize((frame.shape[1] * scale, frame.shape[0] * scale), image.Resampling.NEAREST)
        for frame in frames
    ]
    try:
        pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=40, loop=0, format="GIF")
    except OSError as error:
        raise UsageError(f"--gif {path} cannot be written: {error.strerror or error}") from None
    click.echo(f"wrote {path}: {len(pictures)} frames", err=True)


def _import_pillow() -> Any:
    try:
        from PIL import Image
    except ImportError:
        raise UsageError("--gif needs Pillow; install it with `pip install 'envcraft-rl[gif]'`") from None
    return Image
