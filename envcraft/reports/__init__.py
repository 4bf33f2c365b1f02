"""Reporters: formats that ``--format`` names. Each is a plugin that gives a subclass of :class:`Reporter`."""

from __future__ import annotations

import os
import re
import shlex
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO
from urllib.parse import quote

import msgspec

from envcraft.events import Event
from envcraft.verdict import CheckReport, Finding, Report, Repro, Severity, SubjectReport, Verdict, plain

if TYPE_CHECKING:
    from envcraft.check import Rule

#: What a terminal could take for a command (control characters), for another direction of writing, or what XML forbids.
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)
#: Conditions of a reproduction whose field names say too little.
_CONDITIONS = {
    "before": "after other episodes",
    "companion": "beside another instance",
    "again": "played twice",
    "clock": "another clock",
    "closed": "after another instance was closed",
    "fresh": "fresh worker",
    "render": "with render() in between",
    "unseeded": "reset without a seed",
}


class Frame(NamedTuple):
    """What an episode showed after `step` steps (0 is the reset), as a PNG file."""

    step: int
    png: bytes


#: The frames of a finding's reproduction in order, the last one the moment that it happened; none where there are none.
FrameSource = Callable[[SubjectReport, Finding], list[Frame]]


class Reporter(ABC):
    """Writes one run of ``envcraft validate`` to a text stream.

    Attributes:
        name: how ``--format`` names it.
        summary: one line for the help.
        wants_frames: whether pictures of the findings are of use to it. Who runs it may then set `frames`, which runs
            the environment again in the sandbox; it may be called until :class:`~envcraft.events.Finished` is handled.
    """

    name: str
    summary: str = ""
    wants_frames: bool = False
    frames: FrameSource | None = None

    def __init__(self, output: TextIO, rules: Mapping[str, Rule]) -> None:
        """`rules` are the rules of all checks by code, for their names and fixes."""
        self.output = output
        self.rules = rules

    @abstractmethod
    def handle(self, event: Event) -> None:
        """Take in one event. :class:`~envcraft.events.Finished` is the last one, and carries the whole report."""

    def write(self, text: str) -> None:
        """Write text, with escapes for what the stream's encoding lacks."""
        encoding = self.output.encoding or "utf-8"
        self.output.write(text.encode(encoding, "backslashreplace").decode(encoding))


def one_line(text: Any) -> str:
    """Text that came from an environment, made safe to print: one line, without control characters."""
    return printable(" ".join(str(text).split()))


def printable(text: Any) -> str:
    """Text that came from an environment without control characters, but for line feeds and tabs."""
    return _UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", str(text))


def plural(number: int, noun: str) -> str:
    """A count in words: ``1 finding``, ``2,000 findings``."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


class Numbered(NamedTuple):
    """A finding in its place. `number` counts through the report as ``envcraft replay --finding`` does, `own` through
    the subject alone; `place` is the subject's index.
    """

    number: int
    own: int
    place: int
    subject: SubjectReport
    check: CheckReport
    finding: Finding


def numbered(report: Report) -> Iterator[Numbered]:
    """Every finding of a report, in order."""
    number = 0
    for place, subject in enumerate(report.reports):
        own = 0
        for check in subject.checks:
            for finding in check.findings:
                number, own = number + 1, own + 1
                yield Numbered(number, own, place, subject, check, finding)


def summary_words(report: Report) -> str:
    """A report in one sentence: ``1 passed, 2 failed: 3 findings, 1 warning``."""
    verdicts = Counter(subject.verdict for subject in report.reports)
    words = zip(Verdict, ("passed", "failed", "skipped", "could not be judged"), strict=True)
    counts = ", ".join(f"{verdicts[verdict]:,} {word}" for verdict, word in words if verdicts[verdict])
    severities = Counter(item.finding.severity for item in numbered(report))
    errors, warnings = severities[Severity.ERROR], severities[Severity.WARNING]
    return f"{counts or 'nothing judged'}: {plural(errors, 'finding')}, {plural(warnings, 'warning')}"


def repro_words(repro: Repro) -> str:
    """A reproduction in a few words: ``seed 0, 41 actions, hash_seed 1``."""
    parts = [f"seed {repro.seed}", plural(len(repro.actions), "action") if repro.actions else "no action"]
    parts += [f"{_CONDITIONS.get(name, name)} {_condition(value)}".strip() for name, value in repro.conditions.items()]
    return one_line(", ".join(parts))


def _condition(value: Any) -> str:
    if value is True or isinstance(value, dict | list):
        return ""
    return str(value)


def replay_command(report: Report, item: Numbered) -> str:
    """What to type to see one finding again: the subject judged alone and its report replayed, in two lines."""
    options = [] if report.contract == "arcade" else ["--contract", report.contract]
    options += [] if report.budget == "standard" else ["--budget", report.budget]
    options += ["--seed", str(report.seed)] if report.seed else []
    options += ["--policy", item.subject.policy] if item.subject.policy else []
    options += ["--kwargs", _json(item.subject.kwargs)] if item.subject.kwargs else []
    options += [word for name in item.subject.wrappers for word in ("--wrap", name)]
    path = f"./{item.subject.path}" if item.subject.path.startswith("-") else item.subject.path
    words = ["envcraft", "validate", path, *options, "--format", "json", "--output", "report.json"]
    return f"{shlex.join(map(printable, words))}\nenvcraft replay report.json --finding {item.own}"


def _json(value: Any) -> str:
    return msgspec.json.encode(plain(value)).decode()


def fingerprint(path: str, code: str, nth: int) -> str:
    """What a finding is known by from run to run: hex, of the subject's path as seen from the working directory, the
    code, and which one of this code in this subject it is, from 0. Measured values and lines change with each edit.
    """
    identity = "\0".join((quote(os.fsencode(relative(path))), code, str(nth)))
    # Slow to import, and needed when there is a finding.
    import hashlib

    return hashlib.sha256(identity.encode("utf-8", "backslashreplace")).hexdigest()


def relative(path: str, folder: str | None = None) -> str:
    """A path as seen from `folder` (the working directory) where it lies below that, else absolute."""
    full = os.path.abspath(path)
    seen = os.path.relpath(full, folder)
    return full if seen.split(os.sep)[0] == os.pardir else seen
