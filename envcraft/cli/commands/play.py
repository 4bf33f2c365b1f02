"""``envcraft play``: play an environment by keyboard while it runs in the sandbox."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from envcraft.cli import completion
from envcraft.cli.commands.validate import open_output, read_kwargs, read_wrappers
from envcraft.cli.configured import PartlyConfigured
from envcraft.cli.options import runtime_option
from envcraft.cli.play.recorded import Played
from envcraft.cli.signals import uninterrupted
from envcraft.contracts.lookup import contract_named
from envcraft.corpus.store import is_corpus
from envcraft.environments.targets import resolve
from envcraft.errors import EnvCraftError, ExitCode, Skip, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.driver import driver_for
from envcraft.judging.selection import all_checks, driver_named, rules_of
from envcraft.judging.shrink import repro
from envcraft.model.project import configured
from envcraft.model.verdict import CheckReport, Finding, Report, Repro, Severity, Verdict
from envcraft.text import one_line

if TYPE_CHECKING:
    from envcraft.cli.play.screen import Screen
    from envcraft.judging.engine import Plan
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The longest episode under a contract without a limit; a report can still hold it.
_STEPS = 100_000


@click.command(cls=PartlyConfigured)
@click.argument("target", metavar="TARGET", shell_complete=completion.files)
@click.option(
    "--contract",
    default="arcade",
    show_default=True,
    metavar="NAME",
    shell_complete=completion.contracts,
    help="The interface that the environment promises.",
)
@click.option("--class", "env_class", metavar="NAME", help="The environment class, if a file defines several.")
@click.option("--kwargs", metavar="JSON", help="Arguments of the constructor, as a JSON object.")
@click.option(
    "--wrap",
    multiple=True,
    metavar="MODULE:FUNC",
    help="Apply this wrapper. Its module is installed or in the working directory. Can be repeated.",
)
@click.option(
    "--sandbox",
    default="auto",
    show_default=True,
    metavar="NAME",
    shell_complete=completion.sandboxes,
    help="The sandbox that runs the environment.",
)
@runtime_option
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    default=0,
    show_default=True,
    help="Seed of the first episode; each further episode adds 1.",
)
@click.option(
    "--window/--terminal",
    "window",
    default=None,
    help="Play in a window or in the terminal.  [default: a window if one can be opened]",
)
@click.option("--turn-based", is_flag=True, help="Wait for a key before each step.")
@click.option("--fps", type=click.IntRange(1, 240), default=15, show_default=True, help="Steps per second.")
@click.option(
    "--output",
    metavar="REPORT.json",
    shell_complete=completion.files,
    help="Record the episodes for `envcraft replay`.",
)
@click.pass_context
def play(
    ctx: click.Context,
    target: str,
    contract: str,
    env_class: str | None,
    kwargs: str | None,
    wrap: tuple[str, ...],
    sandbox: str,
    runtime: str | None,
    seed: int,
    window: bool | None,
    turn_based: bool,
    fps: int,
    output: str | None,
) -> None:
    """Play an environment with the keyboard.

    \b
    Exit status: 0 no check reports an error
                 1 a check reports an error
                 2 usage error
                 3 the environment could not be played
    """
    promised = contract_named(contract)
    if is_corpus(Path(target)):
        raise UsageError(f"{target} is a corpus; play its environments in the browser: `envcraft explore {target}`")
    found = resolve(target, env_class)
    if len(found) > 1:
        raise UsageError(f"{target} holds {len(found)} environments; play one, such as {found[0].path}")
    chosen = configured(found[0], read_kwargs(kwargs), read_wrappers(wrap))
    with uninterrupted():
        from envcraft.judging.engine import Plan, open_subject

        screen = _screen(window, f"EnvCraft: {target}")
    checks = all_checks()
    with contextlib.ExitStack() as stack:
        stream = stack.enter_context(open_output(output)) if output else None
        driver = stack.enter_context(contextlib.closing(driver_named(sandbox, runtime=runtime)))
        driver = driver_for(driver, [chosen])
        plan = Plan([chosen], promised, driver, checks, BUDGETS["standard"], seed, parallel_jobs=1)
        subject = stack.enter_context(open_subject(plan, chosen))
        session = _Session(plan, subject)
        try:
            status = session.run(screen, None if turn_based else fps)
        finally:
            session.show_results()
            if stream is not None:
                stream.write(session.report().to_json().decode() + "\n")
                click.echo(f"wrote {output}; play it again with `envcraft replay {output}`", err=True)
        ctx.exit(status)


def _screen(window: bool | None, title: str) -> Screen:
    """Open a window or the terminal. Raises UsageError if that is impossible."""
    from envcraft.cli.play.terminal import Terminal
    from envcraft.cli.play.window import Window, available, has_display

    if not (window or (window is None and available())):
        return Terminal()
    opened = Window(title)
    if not has_display():
        raise UsageError("there is no display for --window: DISPLAY and WAYLAND_DISPLAY are not set; use --terminal")
    return opened


class _Session:
    """All episodes of one run, with their findings."""

    def __init__(self, plan: Plan, subject: Subject) -> None:
        self._plan = plan
        self._subject = subject
        self._rules = rules_of(plan.checks)
        self._played = Played()
        self._found: dict[str, list[Finding]] = {self._played.name: []}
        self._unjudged: dict[str, str] = {}
        self._lines: list[str] = []
        self._started = time.monotonic()

    def run(self, screen: Screen, fps: int | None) -> ExitCode:
        """Play until the player quits. Raises UsageError if the environment cannot be played by keyboard."""
        from envcraft.cli.play.description import describe
        from envcraft.cli.play.episode import Episode
        from envcraft.cli.play.game import Game, play_all
        from envcraft.cli.play.keys import keys_for
        from envcraft.judging.engine import run_check
        from envcraft.judging.fit import fitting_contract
        from envcraft.judging.frame_renderer import with_frames
        from envcraft.model.rollout import Conditions, Rollout

        subject = self._subject
        for check in self._plan.checks:
            if check.gate:
                loaded = run_check(check, subject)
                self._take(loaded)
                if loaded.verdict in (Verdict.FAIL, Verdict.ERROR):
                    return self._status
        try:
            keys = keys_for(subject.contract, subject.action_space)
            conditions = with_frames(subject, Conditions())
        except Skip as skip:
            raise UsageError(f"{subject.target.path} cannot be played: {skip}") from None
        except EnvCraftError as error:
            if subject.acts_as_promised or fitting_contract(subject.load().description, subject.contract) is None:
                raise
            raise UsageError(str(error), setting="contract") from None
        if conditions.render:
            fault = subject.rollout(Rollout(self._plan.seed, [], conditions)).fault
            if fault is not None and fault.phase == "render":
                self._lines.append(f"render() raises {one_line(fault)}: the observations are shown as they are")
                conditions = Conditions()
        title = one_line(subject.env_class or subject.target.path)
        steps = subject.contract.limit or _STEPS
        source = subject.target.source or subject.installed_source
        with screen:
            play_all(
                Game(screen, keys, title, fps if keys.idle else None, describe(source, subject.env_class)),
                lambda seed: Episode(subject, seed, conditions, steps),
                self._plan.seed,
                self._ended,
            )
        return self._status

    @property
    def _status(self) -> ExitCode:
        statuses = {Verdict.FAIL: ExitCode.FAIL, Verdict.ERROR: ExitCode.ERROR}
        return statuses.get(self.report().reports[0].verdict, ExitCode.PASS)

    def show_results(self) -> None:
        """Print the results."""
        click.echo("\n".join(self._lines), nl=bool(self._lines))

    def report(self) -> Report:
        """Return the episodes and their findings as a report."""
        from envcraft.judging.engine import report_on

        checks = []
        for name, findings in self._found.items():
            failed = any(finding.severity is Severity.ERROR for finding in findings)
            played = name == self._played.name
            reason = "a person plays, and no rule judges how" if played else self._unjudged.get(name, "")
            unjudged = Verdict.SKIP if played else Verdict.ERROR if reason else Verdict.PASS
            checks.append(CheckReport(name, Verdict.FAIL if failed else unjudged, findings=findings, reason=reason))
        done = report_on(self._plan, self._subject, checks, self._started)
        return Report(self._plan.contract.name, self._plan.seed, [done], budget=self._plan.budget.name)

    def _ended(self, trace: Trace) -> list[str]:
        """Judge an episode and return the lines to show."""
        from envcraft.judging.engine import run_check

        [episode] = self._played.find(self._subject, trace)
        self._found[self._played.name].append(episode)
        self._lines.append(episode.message)
        lines = []
        for check in self._plan.checks:
            # The other checks need many episodes.
            if type(check).find is not Check.find:
                lines += self._take(run_check(check, self._subject, trace), trace)
        return lines

    def _take(self, judged: CheckReport, trace: Trace | None = None) -> list[str]:
        """Keep new findings and return the lines to show."""
        known = self._found.setdefault(judged.check, [])
        lines = []
        if judged.verdict is Verdict.ERROR and judged.check not in self._unjudged:
            self._unjudged[judged.check] = judged.reason
            lines.append(f"{judged.check}: {one_line(judged.reason)}")
        for finding in judged.findings:
            if finding.code in {other.code for other in known}:
                continue
            if trace is not None and finding.repro == Repro():
                finding = msgspec.structs.replace(finding, repro=repro(trace.rollout))
            known.append(finding)
            where = f"line {finding.line}: " if finding.line else ""
            lines.append(f"{finding.code} {where}{one_line(finding.message)}")
            if finding.code in self._rules:
                lines.append(f"      usual fix: {self._rules[finding.code].fix}")
        self._lines += lines
        return lines
