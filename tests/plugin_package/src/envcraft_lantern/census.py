"""``envcraft census``: how often each verdict and each code occurs in a report."""

from __future__ import annotations

from collections import Counter
from typing import BinaryIO

import click
import msgspec

from envcraft.errors import UsageError
from envcraft.model.verdict import SubjectReport
from envcraft.text import one_line


@click.command()
@click.argument("report", type=click.File("rb"), metavar="REPORT.jsonl")
def census(report: BinaryIO) -> None:
    """Count the verdicts and the codes in what `validate --format jsonl` wrote."""
    verdicts: Counter[str] = Counter()
    codes: Counter[str] = Counter()
    for number, line in enumerate(report, 1):
        try:
            subject = msgspec.json.decode(line, type=SubjectReport)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise UsageError(f"line {number} of {report.name} is not a report on an environment: {error}") from None
        verdicts[subject.verdict.value] += 1
        # A code counts once for each environment.
        codes.update({finding.code for check in subject.checks for finding in check.findings})
    for name, count in [*sorted(verdicts.items()), *sorted(codes.items(), key=lambda item: (-item[1], item[0]))]:
        click.echo(f"{count:8,} {one_line(name)}")
