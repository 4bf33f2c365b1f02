"""The record of one rollout, built on the host from the raw values while they stream, and never larger than it must be.

Frames are judged as they arrive and dropped: a trace keeps a digest of each, and what was wrong with it. The digest is
XXH3 of 128 bits, which tells values apart by chance only: code that made up two values with one digest would hide
nothing that it could not hide by giving one value twice.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
import xxhash
from numpy.typing import NDArray

from envcraft import spaces
from envcraft.contract import Success
from envcraft.description import Description, Outcome, describe
from envcraft.description import outcome as read_outcome
from envcraft.errors import MalformedValue
from envcraft.membership import problem, refuse
from envcraft.rollout import Rollout
from envcraft.sandbox import How, JobEnd, Step, Steps, Stop
from envcraft.similarity.behavioural import EVERY, STEPS
from envcraft.similarity.perceptual import frame_hash, value_hash
from envcraft.values import Layout

_MAX_PROBLEMS = 3
_MAX_LAYOUTS = 4096
#: Layouts of one job, counting the parts of each.
_MAX_PARTS = 100_000
#: Bytes of info, and of frames, that one trace keeps as they are.
_MAX_INFOS = 256 * 1024
_MAX_FRAMES = 64 * 1024 * 1024
#: Pixels of the longer side of a frame of render() that is kept.
_RENDERED_SIDE = 256
_MAX_OUTPUT = 2000


class Ending(StrEnum):
    """How the episode of a trace ended."""

    TERMINATED = "terminated"
    TRUNCATED = "truncated"
    CUT = "cut"  #: the actions ran out, or the player left
    RAISED = "raised"  #: the environment raised, or returned something of the wrong form
    BROKEN = "broken"  #: a sandbox event: deadline, death, flood, forged messages
    REFUSED = "refused"  #: the policy's action was refused


@dataclass(frozen=True)
class Fault:
    """A call that raised or returned a value of the wrong form (`malformed`). `step` 0 is the reset."""

    phase: str
    step: int
    type: str = ""
    message: str = ""
    malformed: str = ""
    line: int | None = None
    memory: bool = False
    errno: int | None = None
    traceback: str = ""

    def __str__(self) -> str:
        return f"{self.type}: {self.message}" if self.message else self.type or f"returned {self.malformed}"


@dataclass(frozen=True)
class Problem:
    """Something wrong with the value of one step. `kind` is ``type`` or ``range``."""

    step: int
    kind: str
    words: str


@dataclass
class Trace:
    """One episode. Index 0 of `observations` and `infos` is the reset, of rewards and flags step 1.

    Observations are digests; of an episode that is watched, `watched` has perceptual hashes of some. Infos are JSON as
    it came, the last one always; once an episode has given much of it the others are digests too.
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
    problems: list[Problem] = field(default_factory=list)
    info_notes: list[tuple[int, dict[str, Any]]] = field(default_factory=list)
    overwritten: list[int] = field(default_factory=list)
    acted: list[tuple[int, Any]] = field(default_factory=list)
    render_problems: list[Problem] = field(default_factory=list)
    renders: int = 0
    chosen: list[Any] = field(default_factory=list)
    after: list[tuple[float, bool, bool]] = field(default_factory=list)
    frames: list[NDArray[Any]] = field(default_factory=list)
    rendered: list[NDArray[Any]] = field(default_factory=list)
    watched: list[int] = field(default_factory=list)
    fault: Fault | None = None
    refused: str = ""
    end: JobEnd | None = None
    result: Outcome | None = None
    earlier: Trace | None = None
    rule: Success = field(default_factory=Success)

    @property
    def steps(self) -> int:
        """Steps taken in the episode."""
        return len(self.rewards)

    @property
    def actions(self) -> list[Any]:
        """The actions that led to the trace, as far as it goes, and the one that broke it."""
        extra = (self.fault is not None and self.fault.phase == "step") or self.ending is Ending.BROKEN
        return self.given[: self.steps + bool(extra)]

    @property
    def given(self) -> list[Any]:
        """The actions that there were, whether they were taken or not."""
        return self.chosen if self.rollout.live else self.rollout.actions

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
        if self.end is not None and self.end.how not in (How.DONE, How.STOPPED):
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

    @property
    def choosing(self) -> bool:
        """Whether the sandbox ended the episode while its policy was choosing a move."""
        stuck = self.ending is Ending.BROKEN and self.end is not None and self.end.phase == "step"
        return stuck and self.rollout.policy and len(self.chosen) == self.steps

    @property
    def total(self) -> float:
        """The return: the undiscounted sum of rewards."""
        return float(sum(self.rewards))

    @property
    def printed(self) -> dict[str, Any]:
        """The end of what the code printed, as evidence: never parsed, and {} for nothing."""
        return {"output": self.end.output[-_MAX_OUTPUT:]} if self.end is not None and self.end.output.strip() else {}

    def info(self, step: int = -1) -> dict[str, Any]:
        """The info of one step (0 is the reset), or {} where it is no JSON object or was not kept."""
        try:
            value = json.loads(self.infos[step] or b"{}")
        except (ValueError, IndexError, RecursionError):
            return {}
        return value if isinstance(value, dict) else {}

    @property
    def success(self) -> bool | None:
        """Success by ``info["is_success"]`` where given, else by the return's sign at a terminated end.

        None where neither says anything, or the contract lets neither: no ``is_success`` and no terminated end.
        """
        told = self.told
        if told is not None:
            return bool(told)
        if self.ending is Ending.TERMINATED and self.rule.sign:
            return self.total > 0
        return None

    @property
    def told(self) -> Any:
        """What the last info says of success; None for nothing."""
        return self.info().get(self.rule.key) if self.infos else None

    @property
    def positive(self) -> bool:
        """A positive outcome: success, or without ``is_success`` a positive return at any end."""
        told = self.told
        return bool(told) if told is not None else self.rule.sign and self.ended and self.total > 0


def digest(trace: Trace) -> str:
    """A digest of what :func:`diverge` compares, and of the way in which the episode ended."""
    numbers = struct.pack(f"<{trace.steps}d", *trace.rewards) + bytes([*trace.terminated, *trace.truncated])
    end = f"{trace.ending} {trace.fault.type if trace.fault else ''}".encode()
    parts = [*trace.observations, numbers, *trace.infos, end]
    return hashlib.blake2b(b"".join(len(part).to_bytes(8) + part for part in parts), digest_size=16).hexdigest()


def digest_all(traces: Iterable[Trace]) -> str:
    """One digest of several traces in their order; empty for none."""
    digests = [digest(trace) for trace in traces]
    return hashlib.blake2b("".join(digests).encode(), digest_size=16).hexdigest() if digests else ""


#: The fields of a trace that must be equal under the same seed, in the order in which a step gives them.
FIELDS = ("observation", "reward", "terminated", "truncated", "info")


@dataclass(frozen=True)
class Divergence:
    """The first step (0 is the reset) and field in which two traces differ, with both values where they show."""

    step: int
    field: str
    first: Any = None
    second: Any = None

    def __str__(self) -> str:
        at = "the reset" if self.step == 0 else f"step {self.step}"
        values = "" if self.first is None else f" ({_short(self.first)}, then {_short(self.second)})"
        return f"{self.field} differs at {at}{values}"


def diverge(first: Trace, second: Trace) -> Divergence | None:
    """Compare two traces bit by bit as far as both go; a trace that stops early differs there."""
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
        if not _same_info(first.infos[step], second.infos[step]):
            return Divergence(step, "info", *_first_difference(first.info(step), second.info(step)))
    return None


class Recording:
    """Receives a job's messages (:class:`envcraft.sandbox.Recorder`) and builds a :class:`Trace`.

    `observation_space` and `action_space` are what the values are checked against, the former exactly as the contract
    says or as its environment means it; `success` tells what winning is; of an episode to `watch`, the hashes are kept
    that a fingerprint is made of (:mod:`envcraft.similarity.behavioural`). Raises MalformedValue on bytes that
    no layout allows.
    """

    def __init__(
        self,
        rollout: Rollout,
        observation_space: dict[str, Any] | None,
        action_space: dict[str, Any] | None,
        *,
        exact: bool = True,
        success: Success | None = None,
        watch: bool = False,
    ) -> None:
        self._watch = STEPS if watch else -1
        self._success = success or Success()
        self._exact_space = exact
        self._rollout = rollout
        self._observation_space = observation_space
        self._action_space = action_space
        self.begin()

    def begin(self) -> None:
        """Forget what has come: the job runs from the start."""
        self.trace = Trace(self._rollout, rule=self._success)
        self.description: Description = {}
        self._layouts: list[Layout] = []
        self._exact: list[bool] = []
        self._parts = 0
        self._infos = 0
        self._frames = 0
        #: The last value and its layout, with their digest.
        self._digested: tuple[memoryview, Layout, bytes] | None = None

    def phase(self, name: str) -> None:
        pass

    def loaded(self, description: dict[str, Any]) -> None:
        self.description = describe(description)

    def layout(self, description: dict[str, Any]) -> None:
        if len(self._layouts) >= _MAX_LAYOUTS:
            raise MalformedValue(f"more than {_MAX_LAYOUTS} layouts")
        layout = Layout(description)
        self._parts += layout.parts
        if self._parts > _MAX_PARTS:
            raise MalformedValue(f"layouts of more than {_MAX_PARTS} parts")
        self._layouts.append(layout)
        self._exact.append(self._is_any_frame(layout))

    def reset(self, step: Step) -> None:
        if self.trace.observations:
            if self.trace.earlier is not None or not self.trace.rollout.conditions.again:
                raise MalformedValue("a second reset")
            self.trace = Trace(self.trace.rollout, earlier=self.trace, rule=self._success)
        self._observe(step)

    def step(self, step: Step) -> None:
        trace = self.trace
        if not trace.observations or trace.steps >= len(trace.given):
            raise MalformedValue("a step that was not asked for")
        trace.rewards.append(step.reward)
        trace.reward_types.append(step.reward_type)
        trace.terminated.append(step.terminated)
        trace.truncated.append(step.truncated)
        trace.flag_types.append((step.terminated_type, step.truncated_type))
        self._observe(step)

    def steps(self, steps: Steps) -> None:
        trace, layout, count = self.trace, self._layout(steps.layout), len(steps.rewards)
        looked_at = trace.steps <= self._watch or len(trace.frames) < trace.rollout.keep
        judged = self._exact[steps.layout] or len(trace.problems) >= _MAX_PROBLEMS
        asked_for = trace.observations and trace.steps + count <= len(trace.given)
        if looked_at or not judged or not asked_for or len(steps.data) != layout.size:
            for step in _each(steps):
                self.step(step)
            return
        trace.rewards += steps.rewards
        trace.reward_types += steps.reward_types
        trace.terminated += steps.terminated
        trace.truncated += steps.truncated
        trace.flag_types += zip(steps.terminated_types, steps.truncated_types, strict=True)
        trace.micros += sum(steps.micros)
        trace.observations += [self._digest(layout, steps.data)] * count
        self._keep_info(steps.info)
        trace.infos += [trace.infos[-1]] * (count - 1)

    def after(self, step: Step) -> None:
        if len(self.trace.after) >= self.trace.rollout.conditions.after_end:
            raise MalformedValue("a step after the end that was not asked for")
        self.trace.after.append((step.reward, step.terminated, step.truncated))

    def action(self, action: Any) -> None:
        if len(self.trace.chosen) >= self.trace.rollout.max_steps:
            raise MalformedValue("an action that was not asked for")
        self.trace.chosen.append(action)
        if self._action_space is not None and (wrong := refuse(self._action_space, action)):
            self.trace.refused = wrong
            raise Stop

    def render(self, layout: int, data: memoryview) -> None:
        trace, step = self.trace, self.trace.steps
        if not trace.observations:
            raise MalformedValue("a frame before the reset")
        trace.renders += 1
        shape = self._layout(layout)
        self._keep_frame(trace.rendered, shape, _thin(shape.decode(data)))
        if self._digest(shape, data) == trace.observations[-1]:
            return
        if shape.kind != "array" or len(shape.shape) != 3:
            self._note_render(Problem(step, "type", f"render() returned {shape}, not a frame"))
        else:
            self._note_render(Problem(step, "differs", f"render() returned {shape} unlike the observation"))

    def reread(self, layout: int, data: memoryview) -> None:
        if not self.trace.observations:
            raise MalformedValue("an observation again before the reset")
        if self._digest(self._layout(layout), data) != self.trace.observations[-1]:
            self.trace.overwritten.append(self.trace.steps + 1)

    def acted(self, action: Any) -> None:
        if not isinstance(action, dict):
            raise MalformedValue("an action that is not told before and after")
        if len(self.trace.acted) < _MAX_PROBLEMS and action.get("before") != action.get("now"):
            self.trace.acted.append((self.trace.steps + 1, action.get("now")))

    def fault(self, report: dict[str, Any]) -> None:
        if report.get("note"):
            if len(self.trace.info_notes) < _MAX_PROBLEMS:
                note: dict[str, Any] = {key: str(report[key])[:200] for key in ("type", "key") if key in report}
                self.trace.info_notes.append((self.trace.steps, note))
            return
        line, errno = report.get("line"), report.get("errno")
        self.trace.fault = Fault(
            phase=str(report.get("phase")),
            step=self.trace.steps + (report.get("phase") == "step"),
            type=str(report.get("type", "")),
            message=str(report.get("message", ""))[:2000],
            malformed=str(report.get("malformed", ""))[:200],
            line=line if isinstance(line, int) else None,
            memory=bool(report.get("memory")),
            errno=errno if isinstance(errno, int) else None,
            traceback=str(report.get("traceback", ""))[:8000],
        )

    def result(self, outcome: dict[str, Any]) -> None:
        if self._action_space is None:
            raise MalformedValue("a search's result without a search")
        self.trace.result = read_outcome(outcome, self._action_space, self.trace.rollout.max_steps)

    def end(self) -> None:
        """The job says that it is complete: then the whole episode must have come, or what stopped it."""
        trace, rollout = self.trace, self.trace.rollout
        wanted = rollout.max_steps if rollout.live else len(rollout.actions)
        stopped = trace.fault is not None or trace.refused or trace.ended or trace.result is not None
        if not stopped and trace.steps < wanted:
            raise MalformedValue(f"an end after {trace.steps} of {wanted} steps")
        if not stopped and rollout.conditions.again and trace.earlier is None:
            raise MalformedValue("an end before the second episode")

    def _observe(self, step: Step) -> None:
        trace = self.trace
        layout = self._layout(step.layout)
        value = None
        if not self._exact[step.layout] and len(trace.problems) < _MAX_PROBLEMS:
            value = layout.decode(step.data)
            trace.problems += [Problem(trace.steps, *found) for found in self._problems(layout, value)]
        elif len(step.data) != layout.size:
            raise MalformedValue(f"{len(step.data)} bytes for {layout}")
        if trace.steps <= self._watch and trace.steps % EVERY == 0:
            value = layout.decode(step.data) if value is None else value
            picture = layout.kind == "array" and is_picture(layout.shape, layout.dtype)
            trace.watched.append(frame_hash(value) if picture else value_hash(value))
        trace.micros += step.micros
        trace.observations.append(self._digest(layout, step.data))
        self._keep_info(step.info)
        # Where render() is asked for, observations that are no pictures are not what is to be seen.
        seen = not trace.rollout.conditions.render or is_picture(layout.shape, layout.dtype)
        if len(trace.frames) < trace.rollout.keep and seen:
            self._keep_frame(trace.frames, layout, layout.decode(step.data))

    def _digest(self, layout: Layout, data: memoryview) -> bytes:
        last = self._digested
        if last is None or last[0] is not data or last[1] is not layout:
            last = self._digested = data, layout, xxhash.xxh3_128_digest(data, layout.tag)
        return last[2]

    def _keep_frame(self, frames: list[NDArray[Any]], layout: Layout, value: Any) -> None:
        wanted = layout.kind == "array" and len(frames) < self.trace.rollout.keep
        if wanted and self._frames + value.nbytes <= _MAX_FRAMES:
            self._frames += value.nbytes
            frames.append(np.array(value))

    def _keep_info(self, info: bytes) -> None:
        infos = self.trace.infos
        if infos and infos[-1] == info:
            # Most environments repeat their info: share it.
            infos.append(infos[-1])
            return
        if infos and self._infos > _MAX_INFOS:
            infos[-1] = _info_digest(infos[-1])
        self._infos += len(info)
        infos.append(info)

    def _problems(self, layout: Layout, value: Any) -> list[tuple[str, str]]:
        space = self._observation_space
        if layout.kind == "other" and (space is None or space["type"] in spaces.KNOWN):
            return [("type", f"the observation is {layout}")]
        if space is None:
            return []
        found = [problem(space, value, exact=self._exact_space)]
        if (
            found[0]
            and space["type"] == "Box"
            and layout.dtype != np.dtype(space["dtype"])
            and layout.dtype is not None
        ):
            # A wrong dtype hides whether the numbers are in range.
            found.append(problem({**space, "dtype": str(layout.dtype)}, value, exact=self._exact_space))
        return list(dict.fromkeys(problem for problem in found if problem))

    def _is_any_frame(self, layout: Layout) -> bool:
        """Whether every value of this layout is in the space: the usual case of uint8 frames with bounds 0 and 255."""
        space = self._observation_space
        return (
            space is not None
            and space["type"] == "Box"
            and layout.kind == "array"
            and layout.dtype == np.uint8
            and space["dtype"] == "uint8"
            and list(layout.shape) == list(space["shape"])
            and (space["low"], space["high"]) == (0, 255)
        )

    def _layout(self, number: int) -> Layout:
        try:
            return self._layouts[number]
        except IndexError:
            raise MalformedValue(f"layout {number} was never described") from None

    def _note_render(self, problem: Problem) -> None:
        if len(self.trace.render_problems) < _MAX_PROBLEMS:
            self.trace.render_problems.append(problem)


def _each(steps: Steps) -> Iterator[Step]:
    flags = zip(steps.terminated, steps.truncated, strict=True)
    types = zip(steps.terminated_types, steps.truncated_types, steps.reward_types, strict=True)
    for ended, named, reward, micros in zip(flags, types, steps.rewards, steps.micros, strict=True):
        yield Step(*ended, *named, reward, micros, steps.layout, steps.data, steps.info)


def is_picture(shape: Sequence[int], dtype: Any) -> bool:
    """Whether values of this form are grey or RGB frames: ``(H, W)``, ``(H, W, 1)`` or ``(H, W, 3)``, uint8."""
    return dtype == np.uint8 and (len(shape) == 2 or (len(shape) == 3 and shape[2] in (1, 3))) and 0 not in shape


def _thin(value: Any) -> Any:
    """A rendered frame at the size that people look at it; any other value as it is."""
    if not isinstance(value, np.ndarray) or value.ndim != 3:
        return value
    step = -(-max(value.shape[:2]) // _RENDERED_SIDE) or 1
    return value[::step, ::step]


def _info_digest(info: bytes) -> bytes:
    """What stands for a long info: no JSON, so that it reads as none."""
    return b"#" + hashlib.blake2b(info, digest_size=16).digest() if len(info) > 17 else info


def _same_info(one: bytes, two: bytes) -> bool:
    return one == two or _info_digest(one) == two or one == _info_digest(two)


def _first_difference(one: dict[str, Any], two: dict[str, Any]) -> tuple[Any, Any]:
    for key in sorted({*one, *two}):
        if one.get(key) != two.get(key):
            return {key: one.get(key)}, {key: two.get(key)}
    return None, None


def _ending_words(trace: Trace) -> str:
    return str(trace.fault) if trace.fault else f"{trace.ending} after {trace.steps} steps"


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 80 else text[:77] + "..."
