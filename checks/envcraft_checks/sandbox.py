"""# sandbox

## What it does
Reports events that the sandbox stopped while the other checks ran: a call that exceeded its deadline, memory or process
limits, floods of output, network access, a process that died, and messages that violate the protocol. The check always
runs, because other verdicts have no meaning after such an event.

It also reads what the episodes print, and warns if that is a warning of NumPy about the environment's arithmetic: a
number that is too large for its type, a division by zero, or an invalid value. Each line is reported once. A hash that
overflows on purpose is fine with Python's integers, with whole arrays, or inside `numpy.errstate`.

## Why is this bad?
An environment that hangs, exhausts memory or ends its process stops the training run that uses it.

## Example
```python
while not self._free(x, y):     # EC901: never ends once the board is full
    x, y = self.np_random.integers(0, 10, 2)
```
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro, shrunk
from envcraft.model import phases
from envcraft.model.job import ExitReason
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl

from .linting.loading import exiting_line, method_code, printing_line, starting_line, waiting_line, writing_line
from .linting.program import program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: Exceptions of code that uses the network, and the error numbers of refused sockets.
_NETWORK = ("gaierror", "herror", "URLError", "ConnectionRefusedError", "ConnectionError")
_NO_NETWORK = (errno.ENETUNREACH, errno.ENETDOWN)
_ENDS = {
    ExitReason.TIMEOUT: "EC901",
    ExitReason.MEMORY: "EC902",
    ExitReason.PROCESSES: "EC903",
    ExitReason.FLOOD: "EC904",
    ExitReason.DISK: "EC904",
    ExitReason.DIED: "EC906",
    ExitReason.FORGED: "EC907",
}
#: The methods that a phase may call, where it is not named after one.
_METHODS = {"construct": ("__init__",), **dict.fromkeys(("search", "before", "after"), ("reset", "step"))}
#: Events that cost no time: their episodes are shrunk. Others reach a deadline or a limit in each attempt.
_QUICK = ("EC905", "EC906")
#: A warning of NumPy as Python prints it.
_WARNING = re.compile(
    r"^([^\n:]{1,500}):(\d{1,7}): RuntimeWarning: "
    r"((?:overflow|underflow|divide by zero|invalid value) encountered in [\w ]{1,40})$",
    re.MULTILINE,
)
#: The steps of the budget for each step of the search for the one that NumPy warns about.
_PART = 20
#: So many attempts may show the event again.
_ATTEMPTS = 16


class SandboxEvents(Check):
    name = "sandbox"
    always = True
    rules = (
        Rule("EC901", "deadline", "A call did not end within its deadline.", "Bound the loop that the call runs."),
        Rule("EC902", "memory", "The memory limit was reached.", "Keep only data that the episode needs."),
        Rule(
            "EC903", "processes", "The code started a process, or too many threads.", "Start no processes or threads."
        ),
        Rule("EC904", "output", "The code printed or wrote more than the limit.", "Do not print or write in step()."),
        Rule("EC905", "network", "The code used the network.", "Put all data into the file."),
        Rule("EC906", "died", "The process died.", "Never call os._exit or native code that crashes."),
        Rule("EC907", "forged", "Messages violated the protocol.", "Do not use the worker's file descriptors."),
        Rule(
            "EC914",
            "arithmetic-warning",
            "NumPy warns about the code's arithmetic during play.",
            "Guard the division, or use `int` where a number may leave the range of its type.",
            Severity.WARNING,
            confirmed_by=("EC301",),
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        seen: set[str] = set()
        for trace in subject.traces:
            for finding in self.find(subject, trace):
                if finding.code not in seen:
                    seen.add(finding.code)
                    small = finding.code in _QUICK and trace.result is None and not trace.rollout.live
                    yield self._smallest(subject, trace, finding) if small else finding
        yield from self._judge_arithmetic(subject)

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        conditions = Conditions.from_json(finding.repro.conditions)
        trace = subject.rollout(Rollout(finding.repro.seed, finding.repro.actions, conditions))
        if finding.code == "EC914":
            return finding if finding.evidence["warning"] in _warnings(trace).values() else None
        found = self.find(subject, trace)
        return next((again for again in found if again.code == finding.code), None)

    def _smallest(self, subject: Subject, trace: Trace, finding: Finding) -> Finding:
        with subject.cache.patient(_ATTEMPTS):
            return shrunk(subject, trace.rollout, finding, lambda played: self.find(subject, played))

    def _judge_arithmetic(self, subject: Subject) -> Iterator[Finding]:
        """Report each line that NumPy warns about, with the shortest episode that shows it."""
        own = Path(subject.source_file or subject.target.path).name
        shown: dict[int, Trace] = {}
        for trace in subject.traces:
            if trace.result is not None or trace.rollout.live:
                continue
            for line in (line for file, line in _warnings(trace) if Path(file).name == own):
                known = shown.get(line)
                # What warns before the first step of a session may be in another episode of it.
                worth = (bool(trace.rollout.conditions.before), trace.steps)
                if known is None or worth < (bool(known.rollout.conditions.before), known.steps):
                    shown[line] = trace
        for line, trace in sorted(shown.items(), key=lambda each: each[0]):
            words = next(text for (file, at), text in _warnings(trace).items() if at == line and Path(file).name == own)
            trace = self._alone(subject, trace, line)
            step = self._first(subject, trace, line)
            yield self.finding(
                "EC914",
                f"NumPy warns about line {line}, by step {step} under {trace.rollout.player}: {words}",
                line=line,
                repro=repro(trace.rollout.cut(step)),
                step=step,
                warning=words,
            )

    def _alone(self, subject: Subject, trace: Trace, line: int) -> Trace:
        """The first of the episodes before a trace that warns about a line on its own; else the trace."""
        left = subject.budget.steps // _PART
        for episode in trace.rollout.conditions.before:
            left -= len(episode.actions)
            if left < 0 or not subject.affords(len(episode.actions)):
                break
            if episode.seed is not None:
                alone = subject.rollout(Rollout(episode.seed, episode.actions, player=trace.rollout.player))
                if any(at == line for _, at in _warnings(alone)):
                    return alone
        return trace

    def _first(self, subject: Subject, trace: Trace, line: int) -> int:
        """The step at which a line warns first, or one after it if the budget does not allow to find out."""
        first, last, left = -1, trace.steps, subject.budget.steps // _PART
        while last - first > 1 and (middle := (first + last) // 2) <= left and subject.affords(middle):
            left -= middle
            again = subject.rerun(trace.rollout.cut(middle), alone=False)
            first, last = (first, middle) if any(at == line for _, at in _warnings(again)) else (middle, last)
        return last

    def find(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        """The sandbox event that ended a trace, if one did."""
        if (found := self._event(subject, trace)) is not None:
            yield found

    def _event(self, subject: Subject, trace: Trace) -> Finding | None:
        end, fault = trace.end, trace.fault
        limit = fault.limit if fault is not None else None
        raised = subject.raised(fault) if fault is not None else ""
        during = phases.in_words(fault.phase, fault.step) if fault is not None else ""
        if fault is not None and limit is ExitReason.MEMORY:
            return self._found(subject, trace, "EC902", f"{during} ran out of memory: {raised}")
        if fault is not None and limit is ExitReason.PROCESSES:
            words = f"{during} started a process, or too many threads: {raised}"
            return self._found(subject, trace, "EC903", words)
        if fault is not None and limit is ExitReason.DISK:
            return self._found(subject, trace, "EC904", f"{during} wrote more than the limit: {raised}")
        if fault is not None and (fault.errno in _NO_NETWORK or fault.type.rpartition(".")[2] in _NETWORK):
            return self._found(subject, trace, "EC905", f"{during} used the network: {raised}")
        if end is None or end.reason in (ExitReason.DONE, ExitReason.STOPPED) or trace.choosing:
            return None
        code = _ENDS[end.reason]
        where = phases.in_words(end.phase, trace.steps + 1)
        words = {
            ExitReason.TIMEOUT: f"{where} did not end: {end.detail}",
            ExitReason.DIED: f"the process died in {where} ({end.detail})",
            ExitReason.FORGED: f"messages in {where} violate the protocol: {end.detail}",
            ExitReason.FLOOD: f"{where} printed {end.detail}",
            ExitReason.MEMORY: f"{where} took {end.detail}",
            ExitReason.PROCESSES: f"{where} ran {end.detail}",
            ExitReason.DISK: f"{where} wrote {end.detail}",
        }[end.reason]
        return self._found(subject, trace, code, words)

    def _found(self, subject: Subject, trace: Trace, code: str, words: str) -> Finding:
        fault, phase = trace.fault, trace.end.phase if trace.end else "step"
        place = fault.line if fault is not None and fault.phase != "policy" else self._place(subject, code, trace)
        return self.finding(
            code,
            f"{words} (under {trace.rollout.player})",
            line=place or (subject.line_of(phase) if subject.env_class else None),
            repro=repro(trace.rollout.cut(trace.steps + 1)),
            **(fault.evidence if fault is not None else {}),
            **trace.printed,
        )

    def _place(self, subject: Subject, code: str, trace: Trace) -> int | None:
        """The line that led to an event without an exception: one that was running, or the only one that may have."""
        if (end := trace.end) is None or (program := program_of(subject)) is None:
            return None
        if code == "EC901":
            return None if end.whole else waiting_line(program, end.stack)
        run = method_code(program, *_METHODS.get(end.phase, (end.phase.rpartition(" ")[2],)))
        if code == "EC904" and end.reason is ExitReason.FLOOD:
            # Of a wrapper's calls the file has no line.
            found = writing_line(program, end.stack)
            return found or (None if subject.target.wrappers else printing_line(program, run, end.output))
        if code == "EC903" and not end.stack and not subject.target.wrappers:
            return starting_line(program, run)
        if code != "EC906" or end.stack or subject.target.wrappers:
            return next(iter(end.stack), None)
        return exiting_line(program, run)


def _warnings(trace: Trace) -> dict[tuple[str, int], str]:
    """What NumPy warns about in a trace, by the file and the line."""
    output = trace.end.output if trace.end is not None else ""
    return {(found[1], int(found[2])): found[3] for found in _WARNING.finditer(output)}


@hookimpl
def envcraft_checks() -> list[Check]:
    return [SandboxEvents()]
