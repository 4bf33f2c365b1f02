"""What ``envcraft audit`` writes: its summary, its JSON, and the formats of ``envcraft validate``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, TextIO

import click

from envcraft.cli.commands.validate import read_reports
from envcraft.errors import UsageError
from envcraft.judging.selection import all_checks, rules_of
from envcraft.model.events import Finished, SubjectFinished
from envcraft.model.verdict import Outcome, Report, plain
from envcraft.registry import offered
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import counted
from envcraft.text import one_line, plural

if TYPE_CHECKING:
    from envcraft.corpus.audit import Audit
    from envcraft.corpus.baseline import Difference

#: The number of codes, and of findings of each kind, that the console shows.
_SHOWN = 10


def read_audit_reports(
    form: str | None, output: str | None, also: Iterable[str]
) -> tuple[list[tuple[type[Reporter], str | None]], str | None]:
    """Read ``--format``, ``--output`` and ``--report`` of an audit.

    Returns:
        Each format with its file, as :func:`envcraft.cli.commands.validate.read_reports` does, and the folder of the
        report on the corpus or None.

    Raises:
        UsageError: a format does not exist, or two reports have one file or folder.
    """
    formats = {reporter.name for reporter in offered("envcraft_reporters")}
    files = [words for words in also if words.partition(":")[0] in formats]
    folders = [words for words in also if words not in files]
    if len(folders) > 1:
        raise UsageError(f"--report names two folders, {folders[0]} and {folders[1]}; leave one out")
    return read_reports(form, output, files), folders[0] if folders else None


def write(
    run: Audit,
    wanted: Iterable[tuple[type[Reporter], TextIO]],
    header: dict[str, Any],
    outcomes: dict[Outcome, int],
    difference: Difference | None,
) -> None:
    """Write the results of an audit in each format.

    Args:
        run: the audit.
        wanted: each format with its stream.
        header: the first members of the JSON object.
        outcomes: the number of environments by outcome.
        difference: the comparison with a baseline, if there is one.
    """
    for kind, stream in wanted:
        if kind.name == "json":
            _write_json(stream, run, header, outcomes, difference)
        elif kind.name == "console":
            _write_summary(stream, run, outcomes, difference)
        else:
            _write_report(stream, run, kind, header)


def _write_report(stream: TextIO, run: Audit, kind: type[Reporter], header: dict[str, Any]) -> None:
    """Write a format of ``envcraft validate``, in the memory that the reports of all environments take."""
    reporter = kind(stream, rules_of(all_checks()))
    reports = []
    for report in run.reports():
        reporter.handle(SubjectFinished(report))
        reports.append(report)
    reporter.handle(Finished(Report(header["contract"], header["seed"], reports, budget=header["budget"])))


def _write_json(
    stream: TextIO,
    run: Audit,
    header: dict[str, Any],
    outcomes: dict[Outcome, int],
    difference: Difference | None,
) -> None:
    """Write an object like that of ``validate --format json`` with the member ``audit``, one report a line."""
    import msgspec

    def encoded(value: Any) -> str:
        return msgspec.json.encode(plain(value)).decode()

    steps, seconds = run.totals()
    summary = {
        "number": run.number,
        "selected": run.selected,
        "judged": run.judged,
        "known": run.known,
        "verdicts": run.verdicts(),
        "undecided": outcomes.get(Outcome.UNDECIDED, 0),
        "out_of_time": run.out_of_time(),
        "codes": run.codes(),
        "shared": run.shared(),
        "steps": steps,
        "seconds": seconds,
        "baseline": difference,
    }
    stream.write(encoded({**header, "audit": summary})[:-1] + ',"reports":[')
    for number, report in enumerate(run.reports()):
        stream.write(f"{',' if number else ''}\n{encoded(report)}")
    stream.write("]}\n")


def _counts(outcomes: dict[Outcome, int]) -> str:
    return ", ".join(words for _, words in counted(outcomes))


def _say_nothing_selected(say: Callable[[str], None], run: Audit) -> None:
    """Say why an audit selects nothing, and which verdicts stand."""
    from envcraft.corpus.store import environments

    every, last = environments.count(run.store), _counts(environments.outcomes(run.store))
    if not run.selection.only_failed:
        say(f"nothing changed: {plural(every, 'environment')} {'is' if every == 1 else 'are'} up to date")
    else:
        changed = " has changed" if run.selection.changed else ""
        say(f"{plural(every, 'environment')}: none with the verdict fail or error{changed}")
    say(f"last verdicts: {last}" if last else "no verdict yet; leave out --only-failed to judge them")


def _write_summary(stream: TextIO, run: Audit, outcomes: dict[Outcome, int], difference: Difference | None) -> None:
    say = partial(click.echo, file=stream)
    if run.selected:
        steps, seconds = run.totals()
        say(f"{plural(run.selected, 'environment')}: {_counts(outcomes) or 'no verdict'}")
        say(f"{run.judged:,} judged now, {run.known:,} known; {plural(steps, 'step')} in {seconds:,.0f} s of judging")
    else:
        _say_nothing_selected(say, run)
    if outcomes.get(Outcome.FAIL):
        place = run.folder or run.store.root
        say(f"`envcraft corpus list {place} --verdict fail` lists what failed; `envcraft corpus show` has the findings")
    if late := run.out_of_time():
        say(f"{late:,} ran out of time: the next audit judges {'it' if late == 1 else 'them'} again")
    for check, times in run.undecided().items() if outcomes.get(Outcome.UNDECIDED) else ():
        say(f"  {one_line(check)}  undecided in {plural(times, 'environment')}; `envcraft corpus show` has the reasons")
    shared = run.shared()
    for each in shared:
        say(f"  {each.words}")
    codes = {code: times for code, times in run.codes().items() if code not in {each.code for each in shared}}
    warnings = run.warning_codes()
    for code, times in list(codes.items())[:_SHOWN]:
        warning = " (warning)" if code in warnings else ""
        say(f"  {code}{warning}  in {plural(times, 'environment')}")
    if len(codes) > _SHOWN:
        say(f"  and {plural(len(codes) - _SHOWN, 'more code')}")
    if difference is None:
        return
    say(
        f"since the baseline: {len(difference.new):,} new, {len(difference.fixed):,} fixed, "
        f"{difference.unchanged:,} unchanged, {difference.unknown:,} not compared"
    )
    for kind, found in (("new", difference.new), ("fixed", difference.fixed)):
        for item in found[:_SHOWN]:
            say(f"  {kind}  {one_line(item.path)}: {item.code} {one_line(item.message)}")
        if len(found) > _SHOWN:
            say(f"  and {len(found) - _SHOWN:,} more {kind}; --format json lists all")
