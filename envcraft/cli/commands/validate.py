"""``envcraft validate``: judge environments."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TextIO

import click
from click.core import ParameterSource

from envcraft.cli import completion
from envcraft.cli.commands.outputs import report_stream
from envcraft.cli.configured import Configured, blamed
from envcraft.cli.options import check_options, format_option, output_option, policy_of, policy_option, sandbox_options
from envcraft.cli.signals import is_full, uninterrupted
from envcraft.contracts.lookup import contract_named
from envcraft.corpus.baseline import read_baseline
from envcraft.environments.targets import resolve, say_skipped
from envcraft.errors import ExitCode, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Limits, driver_for
from envcraft.judging.selection import all_checks, driver_named, rules_of, select_checks, split
from envcraft.judging.severity import SeverityPolicy, severity_table
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import Finished, SubjectFinished
from envcraft.model.project import configured
from envcraft.model.target import Kind, Target, kind_of
from envcraft.model.verdict import Report, SubjectReport, Verdict
from envcraft.registry import offered
from envcraft.reports.reporter import Reporter, reporter_for, reporter_named
from envcraft.reports.summary import counted
from envcraft.text import plural

#: The option that an error about its value begins with.
_OPTION = re.compile(r"--([\w-]+)")
#: How the constructor's arguments are written.
_LIKE = "write it like '{\"size\": 8}'"


class _ValidateCommand(Configured):
    """Lists the report formats of all plugins in the help."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        with formatter.section("Formats"):
            formatter.write_dl([(reporter.name, reporter.summary) for reporter in offered("envcraft_reporters")])


@click.command(cls=_ValidateCommand)
@click.argument("targets", nargs=-1, required=True, metavar="TARGET...", shell_complete=completion.files)
@check_options()
@click.option("--class", "env_class", metavar="NAME", help="The environment class, if a file defines several.")
@click.option("--kwargs", metavar="JSON", help="Arguments of the constructor, as a JSON object.")
@click.option(
    "--wrap",
    multiple=True,
    metavar="MODULE:FUNC",
    help="Apply this wrapper to each instance. Its module is installed or in the working directory. Can be repeated; "
    "the first is the innermost.",
)
@sandbox_options()
@policy_option()
@format_option()
@output_option()
@click.option(
    "--report",
    "also",
    multiple=True,
    metavar="FORMAT:FILE",
    shell_complete=completion.reports,
    help="Write another report in this format to this file. Can be repeated.",
)
@click.option(
    "--select",
    metavar="CODES",
    shell_complete=completion.codes,
    help="Report only these rules: codes or their first characters, such as EC204,EC05. Rules that are off "
    "by default report only if this option or a severity names them.",
)
@click.option(
    "--ignore",
    metavar="CODES",
    shell_complete=completion.codes,
    help="Do not report these rules: codes or their first characters.",
)
@click.option(
    "--exclude",
    multiple=True,
    metavar="GLOB",
    help="In folders, skip files if their name or a part of their path matches, such as 'old_*'. Can be repeated.",
)
@click.option(
    "--baseline",
    metavar="REPORT.json",
    shell_complete=completion.files,
    help="Do not count the findings of this earlier report.",
)
@click.option("--environments-only", is_flag=True, help="Skip named files that define no environment.")
@click.option("--strict", is_flag=True, help="Treat warnings as errors, and undecided checks as failed.")
@click.option("-x", "--exitfirst", is_flag=True, help="End the run after the first environment that fails.")
@click.option("--exit-zero", is_flag=True, help="Exit with 0 even if an environment fails.")
@click.option("-q", "--quiet", is_flag=True, help="Show no progress. On the console, show only what does not pass.")
@click.option("-v", "--verbose", is_flag=True, help="Show all evidence of each finding on the console.")
@click.pass_context
def validate(
    ctx: click.Context,
    targets: tuple[str, ...],
    contract: str,
    env_class: str | None,
    kwargs: str | None,
    wrap: tuple[str, ...],
    sandbox: str,
    runtime: str | None,
    require_isolation: str | None,
    checks: str | None,
    skip: str | None,
    budget: str,
    seed: int,
    time_limit: float | None,
    fail_fast: bool,
    policy: str | None,
    workers: int | None,
    form: str | None,
    output: str | None,
    also: tuple[str, ...],
    select: str | None,
    ignore: str | None,
    exclude: tuple[str, ...],
    baseline: str | None,
    environments_only: bool,
    strict: bool,
    exitfirst: bool,
    exit_zero: bool,
    quiet: bool,
    verbose: bool,
) -> None:
    """Validate environments in a sandbox.

    A TARGET is a Python file, a folder of such files, package.module:Class, or a registered id such as CartPole-v1.

    \b
    Exit status: 0 no environment fails
                 1 at least one fails
                 2 usage error
                 3 an environment could not be judged
    """
    wanted, promised = read_reports(form, output, also), contract_named(contract)
    severity = severity_of(Path.cwd(), strict, select, ignore, baseline)
    verbosity = _verbosity(ctx, quiet, verbose)
    changes = read_kwargs(kwargs), read_wrappers(wrap)
    files, unusable = _files(ctx, targets, env_class, environments_only, exclude, changes)
    if not files and (unusable or not environments_only):
        ctx.exit(ExitCode.USAGE)

    privileged = policy_of(policy)
    _keep_files(wanted, [*(target.path for target in files if target.kind is Kind.SOURCE), policy or ""])
    report: Report | None = None
    with contextlib.ExitStack() as stack:
        driver = driver_for(driver_named(sandbox, require_isolation, runtime, probe=False), files)
        stack.callback(driver.close)
        pool = stack.enter_context(WorkerPool(driver, Limits(), len(files)))
        # Slow work comes here, while the first worker starts.
        selected = select_checks(checks, skip, severity.select, severity.ignore)
        streams = [stack.enter_context(report_stream(path, not number)) for number, (_, path) in enumerate(wanted)]
        with uninterrupted():
            from envcraft.cli.progress import Progress
            from envcraft.judging.engine import Plan
            from envcraft.judging.engine import validate as judge
            from envcraft.judging.verdict_cache import record
        pool.ensure()
        plan = Plan(
            files,
            promised,
            driver,
            selected,
            BUDGETS[budget],
            seed,
            privileged,
            time_limit=time_limit,
            fail_fast=fail_fast,
            severity=severity,
        )
        misused: dict[str, None] = {}
        # Outside the view, which would erase the words.
        stack.enter_context(_counting(finished := [], len(files)))
        progress = stack.enter_context(Progress(streams[0]))
        rules = rules_of(all_checks())
        reporters = [kind(stream, rules) for (kind, _), stream in zip(wanted, streams, strict=True)]
        for reporter in reporters:
            reporter.verbosity = verbosity
        filmed = [reporter for reporter in reporters if reporter.wants_frames]
        if filmed:
            from envcraft.judging.frame_renderer import FrameRenderer

            frames = stack.enter_context(FrameRenderer(plan))
            for reporter in filmed:
                reporter.frames = frames
        for event in stack.enter_context(contextlib.closing(judge(plan, workers, pool, exitfirst))):
            if isinstance(event, SubjectFinished):
                finished.append(event)
                misused |= dict.fromkeys(blame_settings(event.report, lambda error: blamed(ctx, error)))
            if verbosity >= 0:
                progress.handle(event)
            for reporter in reporters:
                reporter.handle(event)
            if isinstance(event, Finished):
                report = event.report
                for stream in streams:
                    stream.flush()
        assert report is not None
        record(plan, report)
    for words in misused:
        click.echo(f"Error: {words}", err=True)
    ctx.exit(ExitCode.USAGE if unusable else exit_code(report, exit_zero))


def blame_settings(report: SubjectReport, blame: Callable[[UsageError], UsageError]) -> Iterator[str]:
    """Let a report's errors about values of ``[tool.envcraft]`` name the file and the setting, and yield them.

    Args:
        report: the report, whose reasons change.
        blame: returns an error that names the file, or the same error if the value is not from there.
    """
    for check in report.checks:
        option = _OPTION.match(check.reason) if check.wrong_use else None
        if option is None:
            continue
        wrong = UsageError(check.reason, setting=option[1])
        if (other := blame(wrong)) is not wrong:
            # The subject has the reason of its first check that could not judge.
            report.reason = str(other) if report.reason == check.reason else report.reason
            check.reason = str(other)
            yield check.reason


@contextlib.contextmanager
def _counting(finished: list[SubjectFinished], every: int) -> Iterator[None]:
    """If a run ends early, say what is lost.

    After an interrupt, that is how many of several environments were judged, and which command keeps them. After a full
    disk, it is the summary of the report.
    """
    try:
        yield
    except KeyboardInterrupt:
        if every > 1:
            judged = f"{len(finished):,} of {every:,} were judged and not stored" if finished else "none was judged"
            click.echo(f"{judged}; `envcraft audit FOLDER` stores each verdict and resumes", err=True)
        raise
    except OSError as error:
        if is_full(error) and finished:
            counts = counted(Counter(event.report.outcome for event in finished))
            with contextlib.suppress(OSError):
                click.echo(", ".join(words for _, words in counts), err=True)
        raise


def exit_code(report: Report, exit_zero: bool = False) -> ExitCode:
    """Return the exit status of a report; a failure counts more than an error."""
    verdicts = {subject.verdict for subject in report.reports}
    if any(check.wrong_use for subject in report.reports for check in subject.checks):
        return ExitCode.USAGE
    if Verdict.FAIL in verdicts and not exit_zero:
        return ExitCode.FAIL
    return ExitCode.ERROR if Verdict.ERROR in verdicts else ExitCode.PASS


def read_reports(form: str | None, output: str | None, also: Iterable[str]) -> list[tuple[type[Reporter], str | None]]:
    """Read ``--format``, ``--output`` and ``--report``. Without a format, the name of the output decides.

    Returns:
        Each reporter with its file, the one of ``--format`` first. None stands for standard output.

    Raises:
        UsageError: a format does not exist, or two reports have one file.
    """
    suggested = reporter_for(output or "") if form is None else None
    found = [(suggested or reporter_named(form or "console"), output)]
    for words in also:
        name, _, path = words.partition(":")
        if not path:
            raise UsageError(f"--report {words} must be FORMAT:FILE, such as sarif:report.sarif", setting="report")
        try:
            found.append((reporter_named(name), path))
        except UsageError as error:
            raise UsageError(f"--report {words}: {error}", setting="report") from None
    files = [os.path.realpath(path) if path and path != "-" else "standard output" for _, path in found]
    for path in files:
        if files.count(path) > 1:
            raise UsageError(f"two reports have the same file, {path}; name another file for one of them")
    return found


def _verbosity(ctx: click.Context, quiet: bool, verbose: bool) -> int:
    """Read ``--quiet`` and ``--verbose``: -1, 0 or 1. An option takes precedence over the setting of the other.

    Raises:
        UsageError: both are options, or both are settings.
    """
    if quiet and verbose:
        given = [name for name in ("quiet", "verbose") if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE]
        if len(given) == 2:
            raise UsageError("-q and -v contradict each other; leave one out")
        if not given:
            raise UsageError("quiet and verbose contradict each other; leave one out", setting="quiet")
        return -1 if given == ["quiet"] else 1
    return verbose - quiet


def _keep_files(wanted: list[tuple[type[Reporter], str | None]], read: list[str]) -> None:
    """Raise UsageError if a report would replace a file that the run reads."""
    kept = {os.path.realpath(path) for path in read if path}
    for number, (_, path) in enumerate(wanted):
        if path and os.path.realpath(path) in kept:
            words = f"the report {path} would replace the file that is judged; name another file"
            raise UsageError(words, setting="report" if number else "output")


def severity_of(
    folder: Path,
    strict: bool = False,
    select: str | None = None,
    ignore: str | None = None,
    baseline: str | None = None,
    table: Mapping[str, str] | None = None,
) -> SeverityPolicy:
    """Decide which findings of an author's run count.

    Args:
        folder: The folder whose ``pyproject.toml`` holds severities.
        strict: The value of ``--strict``.
        select: The value of ``--select``.
        ignore: The value of ``--ignore``.
        baseline: The value of ``--baseline``.
        table: Severities that win over those of the file.

    Raises:
        UsageError: A name does not exist, or the baseline cannot be read.
    """
    codes, ignored = _codes(select, "select", "checks"), _codes(ignore, "ignore", "skip")
    known = read_baseline(baseline) if baseline else ()
    return SeverityPolicy(severity_table(folder) | dict(table or {}), strict, True, codes, ignored, frozenset(known))


def _codes(names: str | None, setting: str, instead: str) -> tuple[str, ...]:
    """Read ``--select`` or ``--ignore``, and refer to the option `instead` if a name is that of a check.

    Raises:
        UsageError: a name is that of a check, or ``--select`` has no name.
    """
    codes = split(names)
    if setting == "select" and names is not None and not codes:
        raise UsageError(f"--select {names!r} names no code; leave it out, or name one like EC204", setting=setting)
    checks = {check.name for check in all_checks()} if codes else ()
    for name in codes:
        if name.lower() in checks:
            words = f"{name} is a check, and --{setting} takes codes; name --{instead} {name.lower()}"
            raise UsageError(words, setting=setting)
    return tuple(code.upper() for code in codes)


def read_kwargs(text: str | None) -> dict[str, Any]:
    """Read ``--kwargs``, the constructor's arguments. Raises UsageError."""
    try:
        value = json.loads(text or "{}")
    except (ValueError, RecursionError) as error:
        words = f"--kwargs {text} is not JSON ({error}); {_LIKE}"
        raise UsageError(words, setting="kwargs") from None
    if not isinstance(value, dict):
        raise UsageError(f"--kwargs {text} is not a JSON object; {_LIKE}", setting="kwargs")
    return value


def read_wrappers(names: tuple[str, ...]) -> tuple[str, ...]:
    """Read ``--wrap``. Raises UsageError if a name is not ``module:func``."""
    for name in names:
        if kind_of(name) is not Kind.MODULE:
            raise UsageError(
                f"--wrap {name} must be MODULE:FUNC, such as gymnasium.wrappers:FlattenObservation", setting="wrap"
            )
    return names


def _files(
    ctx: click.Context,
    targets: tuple[str, ...],
    env_class: str | None,
    environments_only: bool,
    exclude: tuple[str, ...],
    changes: tuple[dict[str, Any], tuple[str, ...]],
) -> tuple[list[Target], bool]:
    """Resolve all targets, each once; say whether any was unusable, with the reason on stderr.

    Raises:
        UsageError: ``--exclude`` leaves no target.
    """
    excluded = 0
    skipped: list[str] = []
    files: dict[str, Target] = {}
    errors: dict[str, None] = {}

    for path in targets:
        unreadable: dict[str, UsageError] = {}
        try:
            found = resolve(path, env_class, environments_only, unreadable.__setitem__)
            skipped += [path] if not found and os.path.isfile(path) else []
            for target in found:
                if exclude and os.path.isdir(path) and is_excluded(target.path, path, exclude):
                    excluded += 1
                    continue
                # A class of a module has no file here, but a name that is no other path.
                files.setdefault(os.path.abspath(target.path), configured(target, *changes))
        except UsageError as error:
            errors[str(blamed(ctx, error))] = None
        errors |= {str(unreadable[place]): None for place in unreadable if not is_excluded(place, path, exclude)}
    say_skipped(skipped, "file", " without an environment")
    for words in errors:
        click.echo(f"Error: {words}", err=True)
    if excluded and not files and not errors:
        words = f"--exclude leaves none of {plural(excluded, 'environment')}; leave out a pattern"
        raise UsageError(words, setting="exclude")
    return list(files.values()), bool(errors)


def is_excluded(path: str, folder: str, patterns: tuple[str, ...]) -> bool:
    """Whether a glob pattern matches a file below `folder`: its name, a folder of its path, or its path there."""
    parts = os.path.relpath(path, folder).split(os.sep)
    names = {*parts, *("/".join(parts[:depth]) for depth in range(1, len(parts) + 1))}
    return any(fnmatchcase(name, pattern.rstrip("/")) for pattern in patterns for name in names)


def open_output(path: str) -> TextIO:
    """Open the file that ``--output`` names. Raises UsageError."""
    try:
        return open(path, "w", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"the report {path} cannot be written: {error.strerror}") from None
