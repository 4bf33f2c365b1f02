"""The record of one rollout, built on the host from the raw values while they stream, and never larger than it must be.

Frames are judged as they arrive and dropped: a trace keeps a digest of each, and what was wrong with it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft import spaces
from envcraft.rollout import Rollout
from envcraft.sandbox import How, JobEnd, Step, Stop
from envcraft.values import Layout, MalformedValue

_MAX_PROBLEMS = 3
_MAX_LAYOUTS = 4096


class Ending(StrEnum):
    """How the episode of a trace ended."""

    TERMINATED = "terminated"
    TRUNCATED = "truncated"
    CUT = "cut"  #: the actions ran out first
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
    """One episode. Index 0 of `observations` and `infos` is the reset, of rewards and flags step 1."""

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
    fault: Fault | None = None
    refused: str = ""
    end: JobEnd | None = None
    result: dict[str, Any] | None = None
    earlier: Trace | None = None

    @property
    def steps(self) -> int:
        """Steps taken in the episode."""
        return len(self.rewards)

    @property
    def actions(self) -> list[Any]:
        """The actions that led to the trace, as far as it goes, and the one that broke it."""
        given = self.chosen if self.rollout.policy else self.rollout.actions
        extra = (self.fault is not None and self.fault.phase == "step") or self.ending is Ending.BROKEN
        return given[: self.steps + bool(extra)]

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
        if self.end is not None and self.end.how is not How.DONE:
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
    def total(self) -> float:
        """The return: the undiscounted sum of rewards."""
        return float(sum(self.rewards))

    def info(self, step: int = -1) -> dict[str, Any]:
        """The info of one step (0 is the reset), or {} where it is no JSON object."""
        try:
            value = json.loads(self.infos[step] or b"{}")
        except (ValueError, IndexError, RecursionError):
            return {}
        return value if isinstance(value, dict) else {}

    @property
    def success(self) -> bool | None:
        """Success by ``info["is_success"]`` where given, else by the return's sign at a terminated end.

        None where neither says anything: no ``is_success`` and no terminated end.
        """
        told = self.info().get("is_success") if self.infos else None
        if told is not None:
            return bool(told)
        if self.ending is Ending.TERMINATED:
            return self.total > 0
        return None

    @property
    def positive(self) -> bool:
        """A positive outcome: success, or without ``is_success`` a positive return at any end."""
        told = self.info().get("is_success") if self.infos else None
        return bool(told) if told is not None else self.ended and self.total > 0


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
        if first.infos[step] != second.infos[step]:
            return Divergence(step, "info", *_first_difference(first.info(step), second.info(step)))
    return None


class Recording:
    """Receives a job's messages (:class:`envcraft.sandbox.Recorder`) and builds a :class:`Trace`.

    `observation_space` and `action_space` are what the values are checked against. Raises MalformedValue on bytes that
    no layout allows.
    """

    def __init__(
        self,
        rollout: Rollout,
        observation_space: dict[str, Any] | None,
        action_space: dict[str, Any] | None,
    ) -> None:
        self.trace = Trace(rollout)
        self.description: dict[str, Any] = {}
        self._observation_space = observation_space
        self._action_space = action_space
        self._layouts: list[Layout] = []
        self._exact: list[bool] = []

    def phase(self, name: str) -> None:
        pass

    def loaded(self, description: dict[str, Any]) -> None:
        self.description = description

    def layout(self, description: dict[str, Any]) -> None:
        if len(self._layouts) >= _MAX_LAYOUTS:
            raise MalformedValue(f"more than {_MAX_LAYOUTS} layouts")
        layout = Layout(description)
        self._layouts.append(layout)
        self._exact.append(self._is_any_frame(layout))

    def reset(self, step: Step) -> None:
        if self.trace.observations:
            if self.trace.earlier is not None or not self.trace.rollout.conditions.again:
                raise MalformedValue("a second reset")
            self.trace = Trace(self.trace.rollout, earlier=self.trace)
        self._observe(step)

    def step(self, step: Step) -> None:
        trace = self.trace
        given = trace.chosen if trace.rollout.policy else trace.rollout.actions
        if not trace.observations or trace.steps >= len(given):
            raise MalformedValue("a step that was not asked for")
        trace.rewards.append(step.reward)
        trace.reward_types.append(step.reward_type)
        trace.terminated.append(step.terminated)
        trace.truncated.append(step.truncated)
        trace.flag_types.append((step.terminated_type, step.truncated_type))
        self._observe(step)

    def after(self, step: Step) -> None:
        if len(self.trace.after) >= self.trace.rollout.conditions.after_end:
            raise MalformedValue("a step after the end that was not asked for")
        self.trace.after.append((step.reward, step.terminated, step.truncated))

    def action(self, action: Any) -> None:
        if len(self.trace.chosen) >= self.trace.rollout.max_steps:
            raise MalformedValue("an action that was not asked for")
        self.trace.chosen.append(action)
        if self._action_space is not None and (wrong := _refuse(self._action_space, action)):
            self.trace.refused = wrong
            raise Stop

    def render(self, layout: int, data: memoryview) -> None:
        trace, step = self.trace, self.trace.steps
        if not trace.observations:
            raise MalformedValue("a frame before the reset")
        trace.renders += 1
        shape = self._layout(layout)
        shape.decode(data)
        if _digest(shape, data) == trace.observations[-1]:
            return
        if shape.kind != "array" or len(shape.shape) != 3:
            self._note_render(Problem(step, "type", f"render() returned {shape}, not a frame"))
        else:
            self._note_render(Problem(step, "differs", f"render() returned {shape} unlike the observation"))

    def reread(self, layout: int, data: memoryview) -> None:
        if not self.trace.observations:
            raise MalformedValue("an observation again before the reset")
        if _digest(self._layout(layout), data) != self.trace.observations[-1]:
            self.trace.overwritten.append(self.trace.steps + 1)

    def acted(self, action: Any) -> None:
        number = self.trace.steps
        given = self.trace.chosen if self.trace.rollout.policy else self.trace.rollout.actions
        if number < len(given) and not _equal(given[number], action):
            self.trace.acted.append((number + 1, action))

    def fault(self, report: dict[str, Any]) -> None:
        if report.get("note"):
            if len(self.trace.info_notes) < _MAX_PROBLEMS:
                self.trace.info_notes.append((self.trace.steps, report))
            return
        line = report.get("line")
        self.trace.fault = Fault(
            phase=str(report.get("phase")),
            step=self.trace.steps + (report.get("phase") == "step"),
            type=str(report.get("type", "")),
            message=str(report.get("message", ""))[:2000],
            malformed=str(report.get("malformed", ""))[:200],
            line=line if isinstance(line, int) else None,
            memory=bool(report.get("memory")),
            traceback=str(report.get("traceback", ""))[:8000],
        )

    def result(self, outcome: dict[str, Any]) -> None:
        self.trace.result = outcome

    def _observe(self, step: Step) -> None:
        trace = self.trace
        layout = self._layout(step.layout)
        value = None
        if not self._exact[step.layout] and len(trace.problems) < _MAX_PROBLEMS:
            value = layout.decode(step.data)
            trace.problems += [Problem(trace.steps, *found) for found in self._problems(layout, value)]
        elif len(step.data) != layout.size:
            raise MalformedValue(f"{len(step.data)} bytes for {layout}")
        trace.micros += step.micros
        trace.observations.append(_digest(layout, step.data))
        # Most environments repeat their info: share it.
        info = trace.infos[-1] if trace.infos and trace.infos[-1] == step.info else step.info
        trace.infos.append(info)
        if len(trace.frames) < trace.rollout.keep and layout.kind == "array":
            trace.frames.append(np.array(layout.decode(step.data)))

    def _problems(self, layout: Layout, value: Any) -> list[tuple[str, str]]:
        space = self._observation_space
        if layout.kind == "other":
            return [("type", f"the observation is {layout}")]
        if space is None:
            return []
        found = [spaces.problem(space, value)]
        if (
            found[0]
            and space["type"] == "Box"
            and layout.dtype != np.dtype(space["dtype"])
            and layout.dtype is not None
        ):
            # A wrong dtype hides whether the numbers are in range.
            found.append(spaces.problem({**space, "dtype": str(layout.dtype)}, value))
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


def _digest(layout: Layout, data: memoryview) -> bytes:
    return hashlib.blake2b(data, digest_size=16, key=layout.tag).digest()


def _refuse(space: dict[str, Any], action: Any) -> str:
    """Say why an action that a policy chose is not in the space, or nothing."""
    kind = space["type"]
    try:
        value: Any = np.asarray(action) if kind in ("MultiDiscrete", "MultiBinary") else action
        if kind == "Box":
            value = np.asarray(action, dtype=space["dtype"])
        found = spaces.problem(space, value, "the action")
    except (ValueError, TypeError):
        return f"the action {_short(action)} is not in {spaces.describe(space)}"
    return f"{found[1]}, in {spaces.describe(space)}" if found else ""


def _equal(given: Any, now: Any) -> bool:
    if isinstance(given, list) and isinstance(now, list):
        return len(given) == len(now) and all(map(_equal, given, now))
    near = isinstance(given, float) and isinstance(now, int | float) and abs(given - now) < 1e-6
    return near or bool(given == now)


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
