"""# sandbox

## What it does
Reports what the sandbox had to stop while the other checks ran: a call beyond its deadline, memory or process
limits, floods of output, network attempts, a process that died, messages that the worker would not have sent. It
always runs, since no other verdict means anything without it.

Where nine in ten steps of an episode take a millisecond or more, it is played again in a process of its own. If so many
also give up the processor, and the process has used it for less than half of its time, the steps wait: a game that is
paced for people, as `clock.tick(30)` does, whoever plays. What is slow because it computes is let be.

## Why is this bad?
An environment that hangs, exhausts memory or ends its process takes down the training run that it is part of. One that
waits 33 ms at each step gives an agent 30 steps a second, on any machine.

## Example
```python
while not self._free(x, y):     # EC901: never ends once the board is full
    x, y = self.np_random.integers(0, 10, 2)
```
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.check import Check, Rule, Skip
from envcraft.plugins import hookimpl
from envcraft.rollout import Conditions, Rollout
from envcraft.sandbox import How
from envcraft.shrink import repro
from envcraft.verdict import Finding

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace

#: Exceptions of code that asks for the network, and the errors of sockets that are refused.
_NETWORK = ("gaierror", "herror", "URLError", "ConnectionRefusedError", "ConnectionError")
_NO_NETWORK = (errno.ENETUNREACH, errno.ENETDOWN)
_NO_PROCESS = errno.EAGAIN
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
#: Episodes of so many steps tell whether they wait, the share that has to, and the microseconds that one looks.
_STEPS, _NEARLY_ALL, _LOOK = 20, 0.9, 1_000_000
_ENDS = {
    How.TIMEOUT: "EC901",
    How.MEMORY: "EC902",
    How.PROCESSES: "EC903",
    How.FLOOD: "EC904",
    How.DISK: "EC904",
    How.DIED: "EC906",
    How.FORGED: "EC907",
}


class SandboxEvents(Check):
    name = "sandbox"
    always = True
    rules = (
        Rule("EC901", "deadline", "A call did not end within its deadline.", "Bound the loop that the call is in."),
        Rule("EC902", "memory", "The memory limit was reached.", "Keep no more than an episode needs."),
        Rule("EC903", "processes", "A process was started, or too many threads.", "Start no processes or threads."),
        Rule("EC904", "output", "More was printed or written than the limit.", "Print and write nothing in step()."),
        Rule("EC905", "network", "The network was asked for.", "Bring what is needed in the file."),
        Rule("EC906", "died", "The process died.", "Never call os._exit or native code that crashes."),
        Rule("EC907", "forged", "Messages broke the protocol.", "Leave the worker's descriptors alone."),
        Rule(
            "EC908",
            "waits",
            "Steps wait for the clock, or for something else.",
            "Sleep and tick in render_mode human only.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        seen: set[str] = set()
        for trace in subject.traces:
            for finding in self.find(subject, trace):
                if finding.code not in seen:
                    seen.add(finding.code)
                    yield finding
        if subject.overrun and "EC901" not in seen:
            words = f"all episodes together took {subject.seconds:.0f} s, and the rest was not played"
            slowest = sorted(subject.traces, key=lambda trace: trace.end.seconds if trace.end else 0.0)[-1:]
            shown = repro(slowest[0].rollout) if slowest else None
            yield self.finding("EC901", words, line=subject.line_of("step"), repro=shown, seconds=subject.seconds)
            seen.add("EC901")
        plain = [
            trace for trace in subject.traces if trace.rollout.conditions == Conditions() and not trace.rollout.live
        ]
        longest = max(plain, key=lambda trace: trace.steps, default=None)
        if "EC901" not in seen and longest is not None and self._slow(longest):
            steps = _LOOK * longest.steps // longest.micros
            yield from self._waiting(subject, longest.rollout.cut(max(_STEPS, steps)))

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code == "EC908":
            return next(self._waiting(subject, Rollout(finding.repro.seed, finding.repro.actions)), None)
        if "seconds" in finding.evidence:
            raise Skip("it took all episodes together; validate again to see it")
        conditions = Conditions.from_json(finding.repro.conditions)
        found = self.find(subject, subject.rollout(Rollout(finding.repro.seed, finding.repro.actions, conditions)))
        return next((again for again in found if again.code == finding.code), None)

    def find(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        """The sandbox event that ended a trace, if one did."""
        if (found := self._event(subject, trace)) is not None:
            yield found

    def _slow(self, trace: Trace) -> bool:
        return trace.steps >= _STEPS and trace.slow >= _NEARLY_ALL * trace.steps

    def _waiting(self, subject: Subject, rollout: Rollout) -> Iterator[Finding]:
        """What there is to find when the rollout is played in a process of its own, whose waits are counted."""
        trace = subject.measured(rollout)
        end, taken = trace.end, trace.micros / 1e6
        if end is None or not self._slow(trace):
            return
        if end.waits < _NEARLY_ALL * trace.steps or end.cpu > end.seconds / 2:
            return
        words = f"{end.waits} of {trace.steps} steps wait: they took {taken:.3g} s, and"
        yield self.finding(
            "EC908",
            f"{words} their whole process {end.cpu:.2g} s of processor time (under {rollout.player})",
            line=subject.line_of("step"),
            repro=repro(rollout.cut(trace.steps)),
            steps=trace.steps,
            waits=end.waits,
            seconds=taken,
            cpu=end.cpu,
        )

    def _event(self, subject: Subject, trace: Trace) -> Finding | None:
        end, fault = trace.end, trace.fault
        if fault is not None and fault.memory:
            return self._found(subject, trace, "EC902", f"{fault.phase} ran out of memory: {fault.message}")
        if fault is not None and (fault.errno == _NO_PROCESS or "can't start new thread" in fault.message):
            return self._found(
                subject, trace, "EC903", f"{fault.phase} started a process, or too many threads: {fault}"
            )
        if fault is not None and fault.errno in _NO_SPACE:
            return self._found(subject, trace, "EC904", f"{fault.phase} wrote more than it may: {fault}")
        if fault is not None and (fault.errno in _NO_NETWORK or fault.type.rpartition(".")[2] in _NETWORK):
            return self._found(subject, trace, "EC905", f"{fault.phase} asked for the network: {fault}")
        if end is None or end.how in (How.DONE, How.STOPPED) or trace.choosing:
            return None
        code = _ENDS[end.how]
        where = f"step {trace.steps + 1}" if end.phase == "step" else end.phase
        words = {
            How.TIMEOUT: f"{where} did not end: {end.detail}",
            How.DIED: f"the process died in {where} ({end.detail})",
            How.FORGED: f"messages were forged in {where}: {end.detail}",
            How.FLOOD: f"{where} printed {end.detail}",
            How.MEMORY: f"{where} took {end.detail}",
            How.PROCESSES: f"{where} ran {end.detail}",
            How.DISK: f"{where} wrote {end.detail}",
        }[end.how]
        return self._found(subject, trace, code, words)

    def _found(self, subject: Subject, trace: Trace, code: str, words: str) -> Finding:
        phase = trace.end.phase if trace.end else "step"
        return self.finding(
            code,
            f"{words} (under {trace.rollout.player})",
            line=subject.line_of(phase) if subject.env_class else None,
            repro=repro(trace.rollout.cut(trace.steps + 1)),
            **trace.printed,
        )


@hookimpl
def envcraft_checks() -> list[Check]:
    return [SandboxEvents()]
