"""# resources

## What it does
Plays many short episodes on one instance, and reports resources whose use grows with each episode:

- memory (EC910), if 10,000 episodes of the usual length would need 640 MB more,
- threads and open files (EC911),
- files that it writes, and their bytes (EC912),
- work (EC913): the lines of Python of an episode, if they would triple within 10,000 episodes, or its time.

The check repeats the same episode, so a cache that contains it does not grow. It measures memory after garbage
collection. A separate session must confirm that the growth is steady: it resets the episode 72 times, then steps it in
24 or 96 episodes, and then plays it to its end 24 times if it is short. A bounded queue that is not full yet is not a
leak, and neither is data that `reset()` clears.

## Why is this bad?
Training runs 10,000 episodes or more in one process, often in many processes on one machine. After hours, a process
runs out of memory or open files, or becomes too slow to train.

## Example
```python
def reset(self, *, seed=None, options=None):
    super().reset(seed=seed)
    self.replays.append(self.frames)            # EC910: keeps the frames of all episodes
    self.logs.append(open("log.txt", "w"))      # EC911: the files of earlier episodes are still open
```
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from envcraft.errors import Skip, Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.rollout import Conditions, Episode, Rollout
from envcraft.model.verdict import Finding
from envcraft.plugins import hookimpl
from envcraft.text import plural

from .linting.effects import effect_lines
from .linting.growth import growing_line
from .linting.program import program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Resources, Trace
    from envcraft.model.verdict import Line

#: Bytes of memory per episode that are too many, and episodes of a training.
_TOO_MANY, _TRAINING = 64 * 1024, 10_000
#: The usual bytes of a block of Python's allocator, which has 16 to 512.
_BLOCK = 48
#: Growth of the resident memory per episode that says something: the system counts pages, some of them late.
_PAGES = 16 * 1024
#: Measurements that steady growth needs, and the part of it that each quarter of them has at least.
_FEWEST, _UNEVEN = 8, 20
#: How many times more lines the last episode of a training runs than the first.
_TIMES = 3
#: Of the session that confirms growth: resets before those that are measured, measured ones, episodes with steps if the
#: budget allows no more, those that it runs else, and their steps.
_FIRST, _RESETS, _FEWER, _EPISODES, _STEPS = 4, 72, 24, 96, 4
#: Blocks that libraries may keep to use them again. Fewer episodes do not show that their number levels off.
_SPARE = 400
#: The episodes of it whose lines are counted.
_COUNTED = (0, 8, 16, 23)
#: Time is judged as the medians of this many parts. The last one must be several times the first one and so many
#: microseconds longer.
_PARTS, _SLOWER, _MEASURABLE = 8, 3.0, 500
#: The least rank correlation of time with the number of the call. It compares the shortest calls of this many parts,
#: because other programs only add time. A single jump in the middle has .53, and growth on a busy machine .9.
_TREND, _COMPARED = 0.75, 16


class ResourceUse(Check):
    name = "resources"
    rules = (
        Rule(
            "EC910",
            "memory-grows",
            "Memory grows with each episode.",
            "Clear the data of an episode in reset(), and keep data of a bounded number of episodes.",
        ),
        Rule(
            "EC911",
            "handles-grow",
            "Each episode leaves threads or open files.",
            "Open and start things once, or close them in reset().",
        ),
        Rule("EC912", "files-grow", "Each episode writes more files, or larger ones.", "Write no files."),
        Rule(
            "EC913",
            "work-grows",
            "Each episode takes more work than the one before.",
            "Do not loop over data of earlier episodes.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        session = subject.session
        before, usual = session.trace.before, _usual(subject)
        played = Played(session.resets, session.repeated, session.whole, usual)
        groups = (*played[:3], session.varied)
        steps = _steps([*session.repeated, *session.varied])
        suspected = {
            "EC910": played.memory > _TOO_MANY,
            "EC911": any(map(_handles, groups)),
            "EC912": any(map(_files, groups)),
            "EC913": _more_lines(before) or _slower(_resets(before)) or _slower(steps),
        }
        findings: list[Finding] = []
        last, complete = session.trace, session.complete
        if any(suspected.values()):
            last = subject.rollout(_session(subject))
            judged = [self._confirmed(subject, last, code, usual) for code, wrong in suspected.items() if wrong]
            findings = [finding for finding in judged if finding is not None]
            complete = len(last.before) == len(last.rollout.conditions.before)
        yield from findings
        if not findings and not complete:
            measured = sum(episode.resources is not None for episode in last.before)
            if last.fault is not None:
                raise Undecided(f"{plural(measured, 'episode')} could be measured, before one raised")
            raise Skip(f"{plural(measured, 'episode')} could be measured: they took too long")

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        return self._confirmed(subject, subject.rollout(_session(subject)), finding.code, _usual(subject))

    def _confirmed(self, subject: Subject, trace: Trace, code: str, usual: float) -> Finding | None:
        """Judge one rule by the session that confirms growth."""
        measured = [episode for episode in trace.before if episode.resources is not None]
        resets, episodes = measured[_FIRST : _FIRST + _RESETS], measured[_FIRST + _RESETS :]
        planned = len(trace.rollout.conditions.before) - _FIRST - _RESETS
        count = planned - (_FEWER if subject.session.short is not None else 0)
        played = Played(resets, episodes[:count], episodes[count:], usual, _SPARE if count < _EPISODES else 0)
        found = {"EC910": self._memory, "EC911": self._handles, "EC912": self._files, "EC913": self._work}[code](played)
        if found is None:
            return None
        words, line, evidence = found
        place: int | Line = subject.line_of(line)
        if not subject.target.wrappers and (program := program_of(subject)) is not None:
            if code == "EC910":
                place = growing_line(program, line) or place
            elif code != "EC913" and (lines := effect_lines(program, line, files=code == "EC912")):
                place, evidence = lines[0], {**evidence, "lines": lines}
        return self.finding(code, words, line=place, repro=repro(trace.rollout), **evidence)

    def _memory(self, played: Played) -> _Found | None:
        growth = played.memory
        queues = [[_used(trace).queued for trace in traces] for traces in played[:3]]
        filling = any(queued and queued[-1] > queued[len(queued) // 3] for queued in queues)
        if growth <= _TOO_MANY or filling:
            return None
        reset, step, usual = _memory_of(played.resets), played.memory_per_step, played.usual
        parts = [f"each reset() keeps {_bytes(reset)}"] * (reset > growth / 10)
        parts += [f"each step keeps {_bytes(step)}"] * (step * usual > growth / 10)
        if reset + step * usual < growth:
            usual = played.whole[0].steps
            parts = [f"each whole episode keeps {_bytes(growth)}"]
        words = f"memory grows: {' and '.join(parts)}"
        words += f", which is {_bytes(growth * _TRAINING)} after {_TRAINING:,} episodes of {usual:.0f} steps"
        line = "reset" if reset > growth / 2 else "step"
        return words, line, {"per_reset": round(reset), "per_step": round(step), "per_episode": round(growth)}

    def _handles(self, played: Played) -> _Found | None:
        if not (growing := [traces for traces in played[:3] if _handles(traces)]):
            return None
        used = [_used(trace) for trace in growing[0]]
        threads, files = ([getattr(each, name) for each in used] for name in ("threads", "descriptors"))
        kind, values = ("threads", threads) if threads[-1] > threads[0] else ("open files", files)
        words = f"{kind} grow with each episode: from {values[0]} to {values[-1]} in {len(values)} episodes"
        line = "reset" if growing[0] is played.resets else "step"
        return words, line, {"first": values[0], "last": values[-1], "episodes": len(values)}

    def _files(self, played: Played) -> _Found | None:
        if not (growing := [traces for traces in played[:3] if _files(traces)]):
            return None
        first, last = _used(growing[0][0]), _used(growing[0][-1])
        files, size, more = last.files - first.files, last.written - first.written, len(growing[0]) - 1
        grown = [plural(files, "more file")] * (files > 0) + [f"{_bytes(size)} of data"] * (size > 0)
        words = f"{more} more episodes of {growing[0][-1].steps} steps write {' and '.join(grown)}"
        line = "reset" if growing[0] is played.resets else "step"
        return words, line, {"files": files, "bytes": size, "episodes": more}

    def _work(self, played: Played) -> _Found | None:
        if _more_lines(played.episodes):
            lines = [_used(played.episodes[number]).lines for number in _COUNTED]
            words = f"each episode runs more code than the one before: {_STEPS} steps run {lines[0]:,} lines of Python"
            words += f", and {_COUNTED[-1]} episodes later the same steps run {lines[-1]:,}"
            return words, "step", {"first": lines[0], "last": lines[-1], "episodes": _COUNTED[-1]}
        for line, costs in (("reset", _resets(played.resets)), ("step", _steps(played.episodes))):
            if _slower(costs):
                first, *_, last = (median / 1e3 for median in _medians(costs))
                words = f"{line}() takes longer in each episode than in the one before: {first:.2g} ms at first, and "
                words += f"{last:.2g} ms after {len(costs)} calls"
                return words, line, {"first": first / 1e3, "last": last / 1e3, "calls": len(costs)}
        return None


_Found = tuple[str, str, dict[str, Any]]


class Played(NamedTuple):
    """Repetitions of one episode without and with its steps, and those of a whole episode.

    Attributes:
        usual: the usual steps of an episode.
        spare: blocks of memory that are no growth.
    """

    resets: Sequence[Trace]
    episodes: Sequence[Trace]
    whole: Sequence[Trace]
    usual: float
    spare: int = 0

    @property
    def memory(self) -> float:
        """The bytes by which memory grows with each episode."""
        return max(_memory_of(self.resets) + self.usual * self.memory_per_step, _memory_of(self.whole, self.spare))

    @property
    def memory_per_step(self) -> float:
        steps = statistics.mean(trace.steps for trace in self.episodes) if self.episodes else 0
        reset = _memory_of(self.resets)
        more = _memory_of(self.episodes, self.spare) - reset
        # Lists and dictionaries grow in jumps.
        return more / steps if steps and more > reset / 10 else 0.0


def steady(values: Sequence[float]) -> float:
    """How much a value grows from one episode to the next; 0 unless it grows in each quarter of the last two thirds."""
    tail = values[len(values) // 3 :]
    if len(tail) < _FEWEST:
        return 0.0
    bounds = [(len(tail) - 1) * part // 4 for part in range(5)]
    rises = [tail[high] - tail[low] for low, high in itertools.pairwise(bounds)]
    total = tail[-1] - tail[0]
    return total / (len(tail) - 1) if min(rises) > 0 and min(rises) >= total / _UNEVEN else 0.0


def _session(subject: Subject) -> Rollout:
    """The session that confirms growth: the same episode, first without its steps."""
    first = subject.probes.random(0)
    actions = first.actions[:_STEPS]
    count = _EPISODES if subject.affords(_EPISODES * _STEPS) else _FEWER
    episodes = [Episode(first.seed, actions, lines=number in _COUNTED) for number in range(count)]
    short = subject.session.short
    whole = [Episode(short.seed, short.actions)] * _FEWER if short is not None else []
    before = [Episode(first.seed, [])] * (_FIRST + _RESETS) + episodes + whole
    return first.cut(0).under(Conditions(before=before, recorded=True))


def _usual(subject: Subject) -> float:
    """The steps of an episode."""
    return statistics.mean(trace.steps for trace in subject.episodes.whole)


def _used(trace: Trace) -> Resources:
    assert trace.resources is not None
    return trace.resources


def _bytes(size: float) -> str:
    power = next(power for power in range(4) if size < 999.5 * 1024**power or power == 3)
    return f"{size / 1024**power:.3g} {('bytes', 'KiB', 'MiB', 'GiB')[power]}"


def _growth(traces: Sequence[Trace], value: Callable[[Resources], float]) -> float:
    return steady([value(trace.resources) for trace in traces if trace.resources is not None])


def _memory_of(traces: Sequence[Trace], spare: int = 0) -> float:
    """The bytes by which memory grows with each of these episodes, where so many blocks do not count."""
    known = min((_used(trace).blocks for trace in traces if trace.resources is not None), default=0) + spare
    allocated = _growth(traces, lambda used: used.held + _BLOCK * max(used.blocks - known, 0))
    resident = _growth(traces, lambda used: used.resident)
    return max(allocated, resident if resident >= _PAGES else 0.0)


def _handles(traces: Sequence[Trace]) -> float:
    return max(_growth(traces, lambda used: used.threads), _growth(traces, lambda used: used.descriptors))


def _files(traces: Sequence[Trace]) -> float:
    return max(_growth(traces, lambda used: used.files), _growth(traces, lambda used: used.written))


def _more_lines(traces: Sequence[Trace]) -> bool:
    """Whether the same episode runs more lines each time, and too many at the end of a training."""
    counted = [(at, _used(trace).lines) for at, trace in enumerate(traces) if trace.resources and trace.resources.lines]
    if len(counted) < 2:
        return False
    lines = [number for _, number in counted]
    rises = [later - earlier for earlier, later in itertools.pairwise(lines)]
    growth = (lines[-1] - lines[0]) / (counted[-1][0] - counted[0][0])
    return min(rises) > 0 and 3 * min(rises) >= max(rises) and growth * _TRAINING >= _TIMES * lines[0]


def _resets(traces: Sequence[Trace]) -> list[float]:
    return [trace.costs[0] for trace in traces]


def _steps(traces: Sequence[Trace]) -> list[float]:
    return [cost for trace in traces for cost in trace.costs[1:]]


def _parts(costs: Sequence[float], count: int) -> Iterator[Sequence[float]]:
    bounds = [len(costs) * part // count for part in range(count + 1)]
    return (costs[low:high] for low, high in itertools.pairwise(bounds))


def _medians(costs: Sequence[float]) -> list[float]:
    return list(map(statistics.median, _parts(costs, _PARTS)))


def _trend(values: Sequence[float]) -> float:
    """How much values rise with their position, from -1 to 1: Kendall's rank correlation, the statistic of the
    Mann-Kendall test (Mann 1945, doi:10.2307/1907187).
    """
    pairs = list(itertools.combinations(values, 2))
    return sum((later > earlier) - (later < earlier) for earlier, later in pairs) / len(pairs)


def _slower(costs: Sequence[float]) -> bool:
    """Whether calls take several times longer at the end than at the start."""
    if len(costs) < 4 * _PARTS:
        return False
    first, *_, last = _medians(costs)
    if last < _SLOWER * first or last < first + _MEASURABLE:
        return False
    return _trend(list(map(min, _parts(costs, _COMPARED)))) >= _TREND


@hookimpl
def envcraft_checks() -> list[Check]:
    return [ResourceUse()]
