"""# speed

## What it does
Measures a short episode of random play before the other checks play: 100 steps in a separate process, or as many as 5
seconds allow. If the steps look slow, the check measures them again, and reports them only if both measurements are
slow.

- Steps wait (EC908) if nine in ten of them take a millisecond or more and give up the processor, and the process uses
  it for less than half of its time. `clock.tick(30)`, which slows a game down for people, has this effect. The check
  also reports a `reset()` that waits a quarter of a second each time.
- Steps are slow (EC909) if the environment takes fewer of them a second than the contract requires
  (`min-steps-per-second`, 20 by default). The most expensive twentieth of the steps does not count, so an environment
  may load an asset at the first step or sometimes generate a level. The check measures processor time, which does not
  depend on other programs.
- Steps whose cost grows (EC909) are reported if they will be that slow at the end of the longest episode.

The validation of a slow environment takes less than a minute, unless `--time-limit` names another time: the remaining
checks use the remaining time, and EnvCraft skips those that are not settled by then.

## Why is this bad?
Agents need millions of steps. At 20 steps a second a million takes 14 hours. An environment that waits 33 ms at each
step gives an agent 30 steps a second on any machine, and one that computes more in each step than in the last makes
long episodes unusable.

## Example
```python
def step(self, action):
    self.trail.append(self.position)
    for point in self.trail:            # EC909: each step draws all earlier ones
        self._draw(point)
    self.clock.tick(30)                 # EC908: waits for people
```
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from envcraft.errors import Skip, Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding, Line
from envcraft.plugins import hookimpl
from envcraft.text import plural

from .linting.clock import waits
from .linting.program import in_words, program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The steps and the seconds of a measurement, and the seconds of the one that confirms growth.
_STEPS, _SECONDS, _LONGER = 100, 5.0, 12.0
#: The seconds that the validation of a slow environment takes, unless the user names a limit.
_SLOW = 40.0
#: The steps that a judgement needs; fewer are enough if the seconds are over.
_ENOUGH, _FEWEST = 20, 3
#: The share of steps that must wait, and the share of the most expensive steps that does not count.
_NEARLY_ALL, _RARE = 0.9, 0.05
#: The seconds of a reset that is measured again.
_LONG_RESET = 0.25
#: Growth is judged on the medians of this many parts of an episode with at least so many steps. The last one must be
#: several times the first one, and at least so many of the others higher than the one before.
_PARTS, _FOR_GROWTH, _TIMES, _RISES = 8, 64, 3.0, 6
#: The microseconds that the last part's steps take at least.
_MEASURABLE = 500


class Growth(NamedTuple):
    """The cost of a step in microseconds: at the start and at the end of a measurement, and what each step adds."""

    first: float
    last: float
    slope: float
    steps: int

    def at(self, step: int) -> float:
        """The cost of a later step if it goes on like this."""
        return self.last + self.slope * max(step - self.steps, 0)


class Speed(Check):
    name = "speed"
    rules = (
        Rule(
            "EC908",
            "waits",
            "Steps wait for the clock or for another resource.",
            "Sleep and tick only in render_mode human.",
        ),
        Rule(
            "EC909",
            "slow-steps",
            "Steps are too slow for training, or become slower and slower.",
            "Compute less in each step, independent of the length of the episode.",
            waiver="min-steps-per-second = N",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if not subject.acts_as_promised:
            raise Skip("the action space is not the contract's")
        rollout = subject.probes.random(0)
        trace = subject.measured(rollout.cut(_STEPS), _SECONDS)
        if trace.ended and trace.steps < _STEPS and subject.contract.noop is not None:
            # Random play may lose at once.
            idle = subject.probes.noop(0)
            other = subject.measured(idle.cut(_STEPS), _SECONDS)
            if other.steps > trace.steps:
                rollout, trace = idle, other
        found = self._steps(subject, rollout, trace) if _enough(trace) else None
        found = found or self._reset(subject, rollout, trace)
        if found is not None:
            subject.time_limit.shorten(_SLOW)
            yield found
        elif not trace.observations:
            raise Undecided(subject.without_reset(trace))
        elif not trace.usable and not _enough(trace):
            raise Undecided(f"only {plural(trace.steps, 'step')} could be measured")

    def _steps(self, subject: Subject, rollout: Rollout, trace: Trace) -> Finding | None:
        minimum = subject.contract.min_steps_per_second
        if _waiting(trace):
            # A second of waiting outweighs the import, which is part of the processor time.
            steps = max(_ENOUGH, 1_000_000 * trace.steps // trace.micros)
            found = self._waits(subject, subject.measured(rollout.cut(steps), _SECONDS))
            if found is not None:
                return found
        if _pace(trace) < minimum:
            # A few slow steps may be those that load or compile what later ones use.
            few = trace.steps < _ENOUGH
            again = subject.measured(rollout.cut(_ENOUGH if few else trace.steps), _LONGER if few else _SECONDS)
            fastest = max(trace, again, key=_pace)
            if _enough(again) and _pace(fastest) < minimum:
                return self._slow(subject, fastest)
        growing = growth(_costs(trace))
        if growing is not None and growing.at(subject.length) * minimum > 1e6:
            longer = subject.measured(rollout, _LONGER)
            growing = growth(_costs(longer))
            if growing is not None and growing.at(subject.length) * minimum > 1e6:
                return self._slow(subject, longer)
        return None

    def _waits(self, subject: Subject, trace: Trace) -> Finding | None:
        end, taken = trace.end, trace.micros / 1e6
        if end is None or not _enough(trace) or not _waiting(trace) or end.cpu > end.seconds / 2:
            return None
        words = f"{min(end.waits, trace.steps)} of {trace.steps} steps wait: they took {taken:.3g} s, and"
        where, line = _waiting_call(subject, "step")
        return self.finding(
            "EC908",
            f"{words} the process used {end.cpu:.2g} s of processor time{where} (under {trace.rollout.player})",
            line=line,
            repro=repro(trace.rollout.cut(trace.steps)),
            steps=trace.steps,
            waits=min(end.waits, trace.steps),
            seconds=taken,
            cpu=end.cpu,
        )

    def _slow(self, subject: Subject, trace: Trace) -> Finding:
        minimum, growing, rate = subject.contract.min_steps_per_second, growth(_costs(trace)), _pace(trace)
        evidence = {"steps": trace.steps, "steps_per_second": rate, "minimum": minimum}
        if growing is None:
            waits = trace.end is not None and trace.end.cpu < trace.end.busy / 2
            time = ", mostly waiting" if waits else " of processor time"
            words = f"a step takes {1e3 / rate:.3g} ms{time}, which allows {rate:.2g} steps a second"
        else:
            last = growing.at(subject.length)
            rate = 1e6 / last
            evidence |= {"first": growing.first / 1e6, "last": growing.last / 1e6, "at_limit": last / 1e6}
            words = (
                f"steps take longer and longer: {growing.first / 1e3:.2g} ms at the start, {growing.last / 1e3:.2g} ms "
                f"at step {trace.steps:,}, and at this growth {last / 1e3:.3g} ms at step {subject.length:,}, which "
                f"allows {rate:.2g} steps a second"
            )
        return self.finding(
            "EC909",
            f"{words}; the contract {subject.contract.name} requires {minimum:g} (under {trace.rollout.player})",
            line=subject.line_of("step"),
            repro=repro(trace.rollout.cut(trace.steps)),
            **evidence,
        )

    def _reset(self, subject: Subject, rollout: Rollout, trace: Trace) -> Finding | None:
        """Judge a long reset by the second one of a process, because the first may load what all later ones use."""
        if not trace.usable or trace.costs[0] < _LONG_RESET * 1e6:
            return None
        twice = subject.measured(rollout.cut(1).under(Conditions(again=True)), _SECONDS)
        if twice.earlier is None or not twice.usable or twice.end is None:
            return None
        seconds = min(twice.costs[0], twice.earlier.costs[0]) / 1e6
        if seconds < _LONG_RESET:
            return None
        end, shown = twice.end, repro(rollout.cut(trace.steps))
        if end.waits >= 2 and end.cpu < end.seconds / 2:
            words = f"it takes {seconds:.3g} s, and two of them used {end.cpu:.2g} s of processor time"
            where, line = _waiting_call(subject, "reset")
            return self.finding(
                "EC908",
                f"each reset() waits: {words}{where}",
                line=line,
                repro=shown,
                seconds=seconds,
                cpu=end.cpu,
            )
        steps, minimum = trace.steps if trace.ended else subject.length, subject.contract.min_steps_per_second
        rate = steps / (seconds + steps / _pace(trace))
        if rate >= minimum:
            return None
        return self.finding(
            "EC909",
            f"each reset() takes {seconds:.3g} s of processor time, which with {steps} steps of an episode allows "
            f"{rate:.2g} steps a second; the contract {subject.contract.name} requires {minimum:g} "
            f"(under {rollout.player})",
            line=subject.line_of("reset"),
            repro=shown,
            steps=steps,
            steps_per_second=rate,
            minimum=minimum,
        )


def _waiting_call(subject: Subject, method: str) -> tuple[str, int | Line]:
    """The only line of a method, or of what it calls, that waits, in words and as a number; else the method's line."""
    program = program_of(subject) if not subject.target.wrappers else None
    found = dict.fromkeys(waits(program, method)) if program is not None else {}
    if len({suspect.line for suspect in found}) != 1:
        return "", subject.line_of(method)
    words, [line] = in_words(found)
    return f"; {words}", line


def pace(costs: Sequence[float]) -> float:
    """Steps a second, from the microseconds of each step without the most expensive ones."""
    kept = sorted(costs)[: len(costs) - max(int(len(costs) * _RARE), len(costs) > 1)]
    return 1e6 * len(kept) / max(sum(kept), 1e-3)


def _pace(trace: Trace) -> float:
    return pace(_costs(trace))


def _costs(trace: Trace) -> list[float]:
    """The microseconds of processor time of each step: on a machine that does other work, steps take longer."""
    total = sum(trace.costs[1:]) / 1e6
    busy = trace.end.busy if trace.end is not None else total
    share = min(max(busy / max(total, 1e-6), 1e-3), 1.0)
    return [cost * share for cost in trace.costs[1:]]


def growth(costs: Sequence[float]) -> Growth | None:
    """How the cost of a step grows over an episode, from the microseconds of each; None if it does not steadily."""
    if len(costs) < _FOR_GROWTH:
        return None
    bounds = [len(costs) * part // _PARTS for part in range(_PARTS + 1)]
    # Other programs make steps longer, never shorter: the lower quartile is what a step costs by itself.
    parts = [statistics.quantiles(costs[low:high], n=4)[0] for low, high in itertools.pairwise(bounds)]
    rises = sum(later > earlier for earlier, later in itertools.pairwise(parts))
    if parts[-1] < max(_TIMES * parts[0], _MEASURABLE) or rises < _RISES:
        return None
    slope = (parts[-1] - parts[0]) / (len(costs) * (_PARTS - 1) / _PARTS)
    return Growth(parts[0], parts[-1], slope, len(costs))


def _enough(trace: Trace) -> bool:
    spent = not trace.ended and trace.steps >= _FEWEST
    return trace.usable and (trace.steps >= _ENOUGH or spent)


def _waiting(trace: Trace) -> bool:
    waits = trace.end.waits if trace.end is not None else 0
    return min(trace.slow, waits) >= _NEARLY_ALL * trace.steps


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Speed()]
