"""The record of one rollout: the results of every call, small enough to keep all traces of a subject.

A trace keeps a digest of each frame, and the problems of its value. The digest is the 128-bit XXH3, which is not
cryptographic: code that returns two values with one digest could as well return the same value twice.
"""

from __future__ import annotations

import errno
import hashlib
import itertools
import json
import struct
from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from envcraft.model.contract import Success
from envcraft.model.job import ExitReason, JobResult, SearchOutcome
from envcraft.model.rollout import Rollout
from envcraft.text import plural

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MAX_OUTPUT = 2000
#: Characters of a value in a message, and levels of keys that lead to it.
_SHOWN = 80
_DEPTH = 20
_ABSENT = "(absent)"


class Ending(StrEnum):
    """How the episode of a trace ended."""

    TERMINATED = "terminated"
    TRUNCATED = "truncated"
    CUT = "cut"  #: no actions were left, or the player stopped
    RAISED = "raised"  #: the environment raised, or returned a malformed value
    BROKEN = "broken"  #: a sandbox event such as a deadline or a killed process
    REFUSED = "refused"  #: the policy chose an invalid action


@dataclass(frozen=True)
class Fault:
    """A call that raised, or returned a `malformed` value. `step` 0 is the reset.

    Attributes:
        line: of the target's file, which raised or called what did.
        file: another file of its project, or of its package, that raised or called what did; "" if none did.
        file_line: the line of that file.
        module: the module that could not be imported, if that raised.
    """

    phase: str
    step: int
    type: str = ""
    message: str = ""
    malformed: str = ""
    line: int | None = None
    memory: bool = False
    errno: int | None = None
    traceback: str = ""
    file: str = ""
    file_line: int | None = None
    module: str = ""

    @property
    def evidence(self) -> dict[str, Any]:
        """The traceback, and the file and line that raised if that is another file, as data of a finding."""
        elsewhere = {"file": self.file, "file_line": self.file_line} if self.file else {}
        return {"traceback": self.traceback, **elsewhere}

    @property
    def limit(self) -> ExitReason | None:
        """The limit of the sandbox that the call ran into, if one made it raise."""
        if self.memory:
            return ExitReason.MEMORY
        if self.errno == errno.EAGAIN or "can't start new thread" in self.message:
            return ExitReason.PROCESSES
        return ExitReason.DISK if self.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG) else None

    def __str__(self) -> str:
        return f"{self.type}: {self.message}" if self.message else self.type or f"returned {self.malformed}"


@dataclass(frozen=True)
class Problem:
    """A problem of the value of one step. `kind` is ``type`` or ``range``; of a render also ``differs``."""

    step: int
    kind: str
    words: str


@dataclass(frozen=True)
class SpaceChange:
    """A space that differs at a step (0 is the reset) from the one that the new instance had, both as text."""

    step: int
    name: str
    before: str
    now: str


@dataclass(frozen=True)
class Resources:
    """What a process uses after an episode, as the worker says.

    Attributes:
        resident: bytes of memory, in pages of the system.
        held: bytes that the C library's allocator has given out.
        blocks: blocks of at most 512 bytes that Python's allocator has given out.
        lines: lines of Python that the episode ran, 0 if they were not counted.
        written: bytes of all files.
        threads: threads.
        descriptors: open files.
        files: files in the job's folder.
        queued: entries of all queues of bounded length, which are no leak.
    """

    resident: int
    held: int
    blocks: int
    lines: int
    written: int
    threads: int
    descriptors: int
    files: int
    queued: int


@dataclass(frozen=True)
class StateChange:
    """How the fields of the environment's state changed in one call, as the worker says.

    Attributes:
        changed: the digest and a short text of each new or changed field, by its path.
        gone: the paths of fields that no longer exist.
        lines: the lines of the file that the call ran.
    """

    changed: dict[str, tuple[str, str]]
    gone: tuple[str, ...] = ()
    lines: frozenset[int] = frozenset()

    @property
    def size(self) -> int:
        """About the bytes that it takes as JSON."""
        texts = sum(len(path) + len(digest) + len(shown) for path, (digest, shown) in self.changed.items())
        return texts + sum(map(len, self.gone))


#: Microseconds from which a step counts as slow.
SLOW = 1_000


@dataclass
class Trace:
    """One episode. Index 0 of `observations` and `infos` is the reset; index 0 of rewards and flags is step 1.

    Attributes:
        observations: digests. They mean nothing if `opaque`.
        infos: JSON as the worker sent it. After many bytes all but the last are digests.
        micros: microseconds that all calls of reset() and step() took together.
        costs: the microseconds of each call: the reset, then the steps.
        slow: steps that took :data:`SLOW` microseconds or more.
        overwritten: the observations that changed after they were returned, each with the step after which, or None for
            the next reset.
        acted: the steps that changed their action, and to what.
        spaces: those that changed.
        opaque: some observation has a type of another package, whose bytes the worker cannot send.
        frames: the first observations that are arrays of numbers, as many as the rollout keeps.
        values: the first observations of other kinds, such as dictionaries, as many as the rollout keeps.
        watched: perceptual hashes of some observations, for a fingerprint.
        ranges: the lowest and highest value of each channel of these observations, if they are pictures.
        columns: whether the digests of long frames read columns of pixels; None without long frames.
        earlier: the first of two traces under the condition `again`.
        before: the earlier episodes under the condition `recorded`, as many as time allowed.
        resources: what the process used after such an episode.
        states: how the state changed in the first calls, if the rollout keeps its fields.
    """

    rollout: Rollout
    observations: list[bytes] = field(default_factory=list)
    infos: list[bytes] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    reward_types: list[str] = field(default_factory=list)
    terminated: list[bool] = field(default_factory=list)
    truncated: list[bool] = field(default_factory=list)
    flag_types: list[tuple[str, str]] = field(default_factory=list)
    micros: int = 0
    costs: array[int] = field(default_factory=lambda: array("I"))
    slow: int = 0
    opaque: bool = False
    problems: list[Problem] = field(default_factory=list)
    info_notes: list[tuple[int, dict[str, Any]]] = field(default_factory=list)
    overwritten: list[tuple[int, int | None]] = field(default_factory=list)
    acted: list[tuple[int, Any]] = field(default_factory=list)
    spaces: list[SpaceChange] = field(default_factory=list)
    render_problems: list[Problem] = field(default_factory=list)
    renders: int = 0
    chosen: list[Any] = field(default_factory=list)
    after: list[tuple[float, bool, bool]] = field(default_factory=list)
    frames: list[NDArray[Any]] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)
    rendered: list[NDArray[Any]] = field(default_factory=list)
    watched: list[int] = field(default_factory=list)
    ranges: list[tuple[int, int]] = field(default_factory=list)
    fault: Fault | None = None
    refused: str = ""
    end: JobResult | None = None
    result: SearchOutcome | None = None
    columns: bool | None = None
    earlier: Trace | None = None
    before: list[Trace] = field(default_factory=list)
    resources: Resources | None = None
    states: list[StateChange] = field(default_factory=list)
    rule: Success = field(default_factory=Success)

    @property
    def steps(self) -> int:
        """Steps taken in the episode."""
        return len(self.rewards)

    @property
    def actions(self) -> list[Any]:
        """The actions that were taken, and the one that ended the trace with a fault."""
        extra = (self.fault is not None and self.fault.phase == "step") or self.ending is Ending.BROKEN
        return self.given[: self.steps + bool(extra)]

    @property
    def given(self) -> list[Any]:
        """All actions of the rollout, taken or not."""
        return self.rollout.actions or self.chosen

    @property
    def ending(self) -> Ending:
        if self.refused:
            return Ending.REFUSED
        if self.terminated and self.terminated[-1]:
            return Ending.TERMINATED
        if self.truncated and self.truncated[-1]:
            return Ending.TRUNCATED
        if self.fault is not None:
            return Ending.RAISED
        if self.end is not None and self.end.reason not in (ExitReason.DONE, ExitReason.STOPPED):
            return Ending.BROKEN
        return Ending.CUT

    @property
    def ended(self) -> bool:
        """Whether the environment itself ended the episode."""
        return self.ending in (Ending.TERMINATED, Ending.TRUNCATED)

    @property
    def usable(self) -> bool:
        """Whether the episode was reset and stepped without an exception or a sandbox event."""
        return self.ended or (self.ending is Ending.CUT and bool(self.observations))

    def prefix(self, rollout: Rollout) -> Trace:
        """The trace of a rollout whose actions are the first ones of this plain rollout, or go on past its end.

        Returns:
            A trace without frames. Its time is the share of its steps.
        """
        steps = min(len(rollout.actions), self.steps)
        fault = self.fault if self.fault is not None and self.fault.step <= steps else None
        return replace(
            self,
            rollout=rollout,
            observations=self.observations[: steps + 1],
            infos=self.infos[: steps + 1],
            rewards=self.rewards[:steps],
            reward_types=self.reward_types[:steps],
            terminated=self.terminated[:steps],
            truncated=self.truncated[:steps],
            flag_types=self.flag_types[:steps],
            micros=self.micros * steps // max(self.steps, 1),
            costs=self.costs[: steps + 1],
            slow=min(self.slow, steps),
            problems=[problem for problem in self.problems if problem.step <= steps],
            info_notes=[note for note in self.info_notes if note[0] <= steps],
            frames=[],
            watched=[],
            ranges=[],
            after=[],
            fault=fault,
            overwritten=[change for change in self.overwritten if change[1] is not None and change[1] <= steps],
            acted=[change for change in self.acted if change[0] <= steps],
            spaces=[change for change in self.spaces if change.step <= steps],
        )

    @property
    def choosing(self) -> bool:
        """Whether the sandbox ended the episode while the policy was loading or choosing an action."""
        stuck = self.ending is Ending.BROKEN and self.end is not None and self.end.phase in ("policy", "step")
        return stuck and self.rollout.policy and len(self.chosen) == self.steps

    @property
    def total(self) -> float:
        """The return: the undiscounted sum of rewards."""
        return float(sum(self.rewards))

    @property
    def printed(self) -> dict[str, Any]:
        """The last part of what the code printed, as evidence; empty if it printed nothing."""
        return {"output": self.end.output[-_MAX_OUTPUT:]} if self.end is not None and self.end.output.strip() else {}

    def info(self, step: int = -1) -> dict[str, Any]:
        """The info of one step (0 is the reset); empty if it is not a JSON object or was not kept."""
        try:
            value = json.loads(self.infos[step] or b"{}")
        except (ValueError, IndexError, RecursionError):
            return {}
        return value if isinstance(value, dict) else {}

    @property
    def success(self) -> bool | None:
        """Success by ``info["is_success"]`` if present, otherwise by the sign of the return at a terminated end.

        None if neither is known or the contract uses neither.
        """
        reported = self.reported_success
        if reported is not None:
            return bool(reported)
        if self.ending is Ending.TERMINATED and self.rule.sign:
            return self.total > 0
        return None

    @property
    def reported_success(self) -> Any:
        """The value of the contract's success key in the last info; None without one, or if it is no bool or number."""
        value = self.info().get(self.rule.key) if self.infos else None
        return value if isinstance(value, bool | int | float) else None

    @property
    def positive(self) -> bool:
        """Whether the outcome is positive: success, or without ``is_success`` a positive return at any end."""
        reported = self.reported_success
        return bool(reported) if reported is not None else self.rule.sign and self.ended and self.total > 0


def digest(trace: Trace) -> str:
    """A digest of everything that :func:`diverge` compares, and of how the episode ended."""
    numbers = struct.pack(f"<{trace.steps}d", *trace.rewards) + bytes([*trace.terminated, *trace.truncated])
    end = f"{trace.ending} {trace.fault.type if trace.fault else ''}".encode("utf-8", "surrogatepass")
    parts = [*trace.observations, numbers, *trace.infos, end]
    return hashlib.blake2b(b"".join(len(part).to_bytes(8) + part for part in parts), digest_size=16).hexdigest()


def digest_all(traces: Iterable[Trace]) -> str:
    """One digest of several traces in order; empty for no traces."""
    digests = [digest(trace) for trace in traces]
    return hashlib.blake2b("".join(digests).encode(), digest_size=16).hexdigest() if digests else ""


#: The fields of a trace that must be equal under the same seed, in the order of a step's results.
FIELDS = ("observation", "reward", "terminated", "truncated", "info")


@dataclass(frozen=True)
class Divergence:
    """The first step (0 is the reset) and field in which two traces differ, with both values if they are known.

    `where` names the part of an observation, in words: rows and columns of a picture, keys of a dictionary.
    """

    step: int
    field: str
    first: Any = None
    second: Any = None
    where: str = ""

    def __str__(self) -> str:
        at = "the reset" if self.step == 0 else f"step {self.step}"
        first, second = _short(self.first, self.second)
        values = "" if self.first is None else f" ({first}, then {second})"
        return f"{self.field} differs at {at}{f' {self.where}' if self.where else ''}{values}"


def diverge(first: Trace, second: Trace, info: bool = True) -> Divergence | None:
    """Compare two traces bit by bit; a trace that stops early differs there.

    Args:
        first: one trace.
        second: the other.
        info: whether infos must be equal. Success in the last info must be equal in any case.

    Returns:
        The first difference, or None.
    """
    for step in range(max(len(first.observations), len(second.observations))):
        if step >= len(first.observations) or step >= len(second.observations):
            ends = [_ending_words(trace) for trace in (first, second)]
            return Divergence(step, "length", *ends)
        if first.observations[step] != second.observations[step]:
            return Divergence(step, "observation")
        if step:
            for name in ("rewards", "terminated", "truncated"):
                one, two = getattr(first, name)[step - 1], getattr(second, name)[step - 1]
                if one != two and not (one != one and two != two):
                    return Divergence(step, name.removesuffix("s"), one, two)
        if info and not _same_info(first.infos[step], second.infos[step]):
            kept = not any(trace.infos[step].startswith(b"#") for trace in (first, second))
            values = _first_difference(first.info(step), second.info(step)) if kept else ()
            return Divergence(step, "info", *values)
    # Of a prefix, the last info may be known by its digest only.
    kept = not any(trace.infos[-1:] and trace.infos[-1].startswith(b"#") for trace in (first, second))
    if kept and first.reported_success != second.reported_success:
        return Divergence(first.steps, "success", first.reported_success, second.reported_success)
    return None


def info_digest(info: bytes) -> bytes:
    """The digest that replaces a long info. It is not JSON, so it cannot be mistaken for an info."""
    return b"#" + hashlib.blake2b(info, digest_size=16).digest() if len(info) > 17 else info


def _same_info(one: bytes, two: bytes) -> bool:
    if one == two or info_digest(one) == two or one == info_digest(two):
        return True
    # Equal dictionaries may have their keys in different orders.
    try:
        return _same_json(json.loads(one or b"{}"), json.loads(two or b"{}"))
    except (ValueError, RecursionError):
        return False


def _first_difference(one: Any, two: Any) -> tuple[Any, Any]:
    """Both values at the first difference, each in a dict under the path of keys that leads to it."""
    path: list[str] = []
    while len(path) < _DEPTH and (parts := _parts(one, two)):
        differing = (part for part in parts if not _same_json(part[1], part[2]))
        name, one, two = next(differing, ("", None, None))
        path.append(name)
    return ({".".join(path): one}, {".".join(path): two}) if path and path[-1] else (None, None)


def _parts(one: Any, two: Any) -> list[tuple[str, Any, Any]]:
    """Pair the items of two dictionaries or two lists; empty for other values."""
    if isinstance(one, dict) and isinstance(two, dict):
        return [(key or "''", one.get(key, _ABSENT), two.get(key, _ABSENT)) for key in sorted({*one, *two})]
    if isinstance(one, list) and isinstance(two, list):
        pairs = itertools.zip_longest(one, two, fillvalue=_ABSENT)
        return [(str(number), *pair) for number, pair in enumerate(pairs)]
    return []


def _same_json(one: Any, two: Any) -> bool:
    try:
        return json.dumps(one, sort_keys=True) == json.dumps(two, sort_keys=True)
    except RecursionError:
        return False


def _ending_words(trace: Trace) -> str:
    return f"{trace.fault or trace.ending} after {plural(trace.steps, 'step')}"


def _short(one: Any, two: Any) -> tuple[str, str]:
    """Two values as short texts that contain the first difference."""
    texts = str(one), str(two)
    if max(map(len, texts)) <= _SHOWN:
        return texts
    same = next((at for at, pair in enumerate(zip(*texts, strict=False)) if len(set(pair)) > 1), min(map(len, texts)))
    start = max(same - _SHOWN // 4, 0) if same > _SHOWN // 2 else 0
    return _excerpt(texts[0], start), _excerpt(texts[1], start)


def _excerpt(text: str, start: int) -> str:
    end = start + _SHOWN
    return ("..." if start else "") + text[start:end] + ("..." if len(text) > end else "")
