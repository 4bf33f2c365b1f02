"""Build a trace from a job's messages. Each value is validated when it arrives, and then dropped."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import xxhash
from envcraft_protocol.wire import LONG, MAX_STATES_BYTES, is_shown
from numpy.typing import NDArray

from envcraft.errors import MalformedValue
from envcraft.judging.description import Description, describe
from envcraft.judging.description import fields as read_fields
from envcraft.judging.description import outcome as read_outcome
from envcraft.judging.driver import Step, Steps, Stop
from envcraft.model.contract import Success
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.trace import SLOW, Fault, Problem, Resources, SpaceChange, Trace, info_digest
from envcraft.similarity.behavioural import EVERY, STEPS
from envcraft.similarity.perceptual import frame_hash, value_hash
from envcraft.spaces.codec import ValueCodec, is_picture
from envcraft.spaces.spec import Box, SpaceSpec
from envcraft.spaces.validation import validate, validate_action, validate_range

if TYPE_CHECKING:
    from envcraft_protocol.jobs import Pictures

_MAX_PROBLEMS = 3
_MAX_LAYOUTS = 4096
#: Parts of all layouts of one job.
_MAX_PARTS = 100_000
#: Bytes of info that one trace keeps in full; later infos are replaced by their digests.
_MAX_INFOS = 256 * 1024
#: Bytes of frames that one trace keeps.
_MAX_FRAMES = 64 * 1024 * 1024
#: Maximum length in pixels of the longer side of a kept render() frame.
_RENDERED_SIDE = 256
#: Characters of the text of a space.
_MAX_TEXT = 300
#: The most characters of the name of a file or a module.
_MAX_PATH = 1000


class TraceBuilder:
    """Receives a job's messages (:class:`envcraft.judging.driver.Recorder`) and builds a :class:`Trace`.

    Args:
        rollout: the request.
        observation_space: validates observations. None disables the validation.
        action_space: validates the actions that a live player chooses. None disables the validation.
        exact: whether the contract prescribes `observation_space`. False if the environment declared it.
        success: the contract's definition of a win.
        watch: whether to keep the hashes that a fingerprint consists of (:mod:`envcraft.similarity.behavioural`).
        resize: height and width that the contract resizes frames to, if it does.

    Each method that receives bytes raises MalformedValue if no layout allows them.

    Attributes:
        trace: the episode that is received.
        frame: the shape of observations of uint8 that need no validation and travel as digests; None without any.
        pictures: the frames that must come as pictures, too.
    """

    def __init__(
        self,
        rollout: Rollout,
        observation_space: SpaceSpec | None,
        action_space: SpaceSpec | None,
        *,
        exact: bool = True,
        success: Success | None = None,
        watch: bool = False,
        resize: tuple[int, int] | None = None,
    ) -> None:
        self._watch = STEPS if watch else -1
        self._resize = resize
        first = rollout.max_steps + 1 if rollout.interactive else rollout.keep
        self.pictures: Pictures = {"first": first, "every": EVERY, "until": self._watch}
        self.frame = self._frame_shape(observation_space, resize)
        self._success = success or Success()
        self._exact_space = exact
        self._rollout = rollout
        self._observation_space = observation_space
        self._action_space = action_space
        self.restart()

    def restart(self) -> None:
        """Discard all messages, because the job runs again from the start."""
        self.trace = Trace(self._rollout, rule=self._success)
        self.description: Description = {}
        self._layouts: list[ValueCodec] = []
        #: Which layouts are frames, and which layouts need no validation of values.
        self._framed: list[bool] = []
        self._exact: list[bool] = []
        self._columns: bool | None = None
        self._parts = 0
        self._infos = 0
        self._frames = 0
        self._bytes = 0
        self._phase = ""
        #: The recorded episodes before the last one.
        self._before: list[Trace] = []
        #: The last value and its layout, with their digest.
        self._digested: tuple[memoryview, ValueCodec, bytes] | None = None

    @property
    def main(self) -> Trace:
        """The trace of the rollout; without observations if the job ended in an episode before it."""
        if self._is_earlier:
            return Trace(self._rollout, fault=self.trace.fault, before=self._before, rule=self._success)
        return self.trace

    @property
    def _is_earlier(self) -> bool:
        return bool(self._before) and self._before[-1] is self.trace

    def phase(self, name: str) -> None:
        self._phase = name

    def loaded(self, description: dict[str, Any]) -> None:
        self.description = describe(description)

    def layout(self, description: dict[str, Any]) -> None:
        if len(self._layouts) >= _MAX_LAYOUTS:
            raise MalformedValue(f"more than {_MAX_LAYOUTS} layouts")
        framed = description.get("k") == "frame"
        layout = ValueCodec({**description, "k": "array"} if framed else description)
        if framed and (layout.dtype != np.uint8 or layout.size < LONG):
            raise MalformedValue(f"{layout} as a frame")
        columns = description.get("columns") if framed else None
        if columns is not None:
            if not isinstance(columns, bool) or self._columns is (not columns):
                raise MalformedValue("frames in two orders")
            self._columns = self.trace.columns = columns
        self._parts += layout.parts
        if self._parts > _MAX_PARTS:
            raise MalformedValue(f"layouts of more than {_MAX_PARTS} parts")
        self._layouts.append(layout)
        self._framed.append(framed)
        self._exact.append(self._is_any_frame(layout, framed))

    def reset(self, step: Step) -> None:
        if self._rollout.conditions.recorded and self._phase == "before":
            episodes = self._rollout.conditions.before
            if len(self._before) >= len(episodes) or (self.trace.observations and not self._is_earlier):
                raise MalformedValue("an episode that was not requested")
            episode = episodes[len(self._before)]
            rollout = Rollout(episode.seed or 0, episode.actions, Conditions(unseeded=episode.seed is None))
            self.trace = Trace(rollout, rule=self._success, columns=self._columns)
            self._before.append(self.trace)
        elif self._is_earlier:
            self.trace = Trace(self._rollout, before=self._before, rule=self._success, columns=self._columns)
        if self.trace.observations:
            if self.trace.earlier is not None or not self.trace.rollout.conditions.again:
                raise MalformedValue("a second reset")
            self.trace = Trace(self.trace.rollout, earlier=self.trace, rule=self._success, columns=self._columns)
        self._observe(step)

    def step(self, step: Step) -> None:
        trace = self.trace
        if not trace.observations or trace.steps >= len(trace.given):
            raise MalformedValue("a step that was not requested")
        trace.rewards.append(step.reward)
        trace.reward_types.append(step.reward_type)
        trace.terminated.append(step.terminated)
        trace.truncated.append(step.truncated)
        trace.flag_types.append((step.terminated_type, step.truncated_type))
        trace.slow += step.micros >= SLOW
        self._observe(step)

    def steps(self, steps: Steps) -> None:
        trace, count = self.trace, len(steps)
        requested = trace.observations and trace.steps + count <= len(trace.given)
        shown = trace.steps <= self.pictures["until"] or trace.steps < self.pictures["first"]
        if not requested or shown or steps.actions or any(steps.data) or not self._are_frames(steps):
            self._one_by_one(steps)
            return
        trace.rewards += steps.rewards
        trace.reward_types += steps.reward_types
        trace.terminated += steps.terminated
        trace.truncated += steps.truncated
        trace.flag_types += zip(steps.terminated_types, steps.truncated_types, strict=True)
        trace.micros += sum(steps.micros)
        trace.costs.extend(steps.micros)
        trace.slow += sum(micros >= SLOW for micros in steps.micros)
        trace.observations += steps.digests
        trace.renders += sum(steps.rendered)
        for info in steps.infos:
            self._keep_info(info)

    def _are_frames(self, steps: Steps) -> bool:
        """Whether all observations are frames of one layout that need no validation."""
        number = steps.layouts[0]
        self._layout(number)
        alike = steps.layouts.count(number) == len(steps) and all(steps.digests)
        return alike and self._framed[number] and self._exact[number]

    def _one_by_one(self, steps: Steps) -> None:
        trace = self.trace
        actions = iter(steps.actions)
        for number, step in enumerate(steps.each()):
            for action in itertools.islice(actions, max(trace.steps + 1 - len(trace.chosen), 0)):
                self.action(action)
            self.step(step)
            if steps.rendered[number]:
                self.render(step.layout, step.data, step.digest)
        for action in actions:
            self.action(action)

    def after(self, step: Step) -> None:
        if len(self.trace.after) >= self.trace.rollout.conditions.after_end:
            raise MalformedValue("a step after the end that was not requested")
        self.trace.after.append((step.reward, step.terminated, step.truncated))

    def action(self, action: Any) -> None:
        if len(self.trace.chosen) >= self.trace.rollout.max_steps:
            raise MalformedValue("an action that was not requested")
        self.trace.chosen.append(action)
        if self._action_space is not None and (wrong := validate_action(self._action_space, action)):
            self.trace.refused = wrong
            raise Stop

    def render(self, layout: int, data: memoryview, digest: bytes = b"") -> None:
        trace, step = self.trace, self.trace.steps
        if not trace.observations:
            raise MalformedValue("a frame before the reset")
        trace.renders += 1
        shape = self._layout(layout)
        value = self._decode(layout, data, digest)
        if value is not None:
            self._keep_frame(trace.rendered, shape, _thin(value))
        same = (digest or self._digest(shape, data)) == trace.observations[-1]
        if not same and (shape.kind != "array" or len(shape.shape) != 3):
            self._note_render(Problem(step, "type", f"render() returned {shape}, not a frame"))
            return
        # A contract may promise grey pictures, but Gymnasium only knows RGB ones.
        usual = is_picture(shape.shape, shape.dtype) and (same or shape.shape[2:] == (3,))
        if not usual and not any(problem.kind == "format" for problem in trace.render_problems):
            words = f"render() returned {shape}, not the uint8 array of shape (height, width, 3) of rgb_array"
            self._note_render(Problem(step, "format", words))
        if not same:
            self._note_render(Problem(step, "differs", f"render() returned {shape} that differs from the observation"))

    def changed(self, report: dict[str, Any]) -> None:
        at, trace = report.get("at"), self.trace
        if type(at) is not int or not 0 <= at < len(trace.observations):
            raise MalformedValue("a change of an observation that was never sent")
        if len(trace.overwritten) < _MAX_PROBLEMS:
            trace.overwritten.append((at, None if self._phase == "plain reset" else trace.steps))

    def space(self, report: dict[str, Any]) -> None:
        name, spaces = report.get("name"), self.trace.spaces
        if name not in ("observation_space", "action_space") or any(known.name == name for known in spaces):
            raise MalformedValue("a change of an unknown space, or a second one")
        before, now = (str(report.get(when, ""))[:_MAX_TEXT] for when in ("before", "now"))
        spaces.append(SpaceChange(self.trace.steps, name, before, now))

    def acted(self, action: Any) -> None:
        if not isinstance(action, dict):
            raise MalformedValue("an action without its values before and after the step")
        if len(self.trace.acted) < _MAX_PROBLEMS and action.get("before") != action.get("now"):
            self.trace.acted.append((self.trace.steps + 1, action.get("now")))

    def fault(self, report: dict[str, Any]) -> None:
        if report.get("note"):
            if len(self.trace.info_notes) < _MAX_PROBLEMS:
                note: dict[str, Any] = {key: str(report[key])[:200] for key in ("type", "key") if key in report}
                self.trace.info_notes.append((self.trace.steps, note))
            return
        line, errno, file_line = (report.get(name) for name in ("line", "errno", "file_line"))
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
            file=str(report.get("file") or "")[:_MAX_PATH] if isinstance(file_line, int) else "",
            file_line=file_line if isinstance(file_line, int) else None,
            module=str(report.get("module") or "")[:_MAX_PATH],
        )

    def resources(self, measured: tuple[int, ...]) -> None:
        if not self._is_earlier or self.trace.resources is not None:
            raise MalformedValue("a measurement that was not requested")
        self.trace.resources = Resources(*measured)

    def result(self, outcome: dict[str, Any]) -> None:
        if self._action_space is None:
            raise MalformedValue("a search's result without a search")
        self.trace.result = read_outcome(outcome, self._action_space, self.trace.rollout.max_steps)

    def fields(self, state: dict[str, Any]) -> None:
        trace = self.trace
        if not self._rollout.fields or self._is_earlier or len(trace.states) + 1 != len(trace.observations):
            raise MalformedValue("the fields of a state that was not requested")
        trace.states.append(change := read_fields(state))
        self._bytes += change.size
        if self._bytes > MAX_STATES_BYTES:
            raise MalformedValue(f"fields of more than {MAX_STATES_BYTES} bytes")

    def end(self) -> None:
        """Check that a complete job sent the whole episode or the reason why it stopped.

        Raises:
            MalformedValue: it sent neither.
        """
        trace, rollout = self.trace, self.trace.rollout
        wanted = rollout.max_steps if rollout.live else len(rollout.actions)
        stopped = trace.fault is not None or trace.refused or trace.ended or trace.result is not None
        if self._is_earlier and trace.fault is None:
            raise MalformedValue("an end before the last episode")
        if not stopped and trace.steps < wanted:
            raise MalformedValue(f"an end after {trace.steps} of {wanted} steps")
        if not stopped and rollout.conditions.again and trace.earlier is None:
            raise MalformedValue("an end before the second episode")

    def _observe(self, step: Step) -> None:
        trace = self.trace
        layout = self._layout(step.layout)
        framed = bool(step.digest)
        self._check_framed(step.layout, step.digest)
        if framed and not self._exact[step.layout]:
            raise MalformedValue(f"{layout} as a frame, which needs validation")
        value: Any = self._decode(step.layout, step.data, step.digest) if framed else None
        if not framed and not self._exact[step.layout] and len(trace.problems) < _MAX_PROBLEMS:
            value = layout.decode(step.data)
            trace.problems += [Problem(trace.steps, *problem) for problem in self._problems(layout, value)]
        elif not framed and len(step.data) != layout.size:
            raise MalformedValue(f"{len(step.data)} bytes for {layout}")
        # Where render() is part of the request, it may show what observations that are no pictures do not.
        seen = not trace.rollout.conditions.render or is_picture(layout.shape, layout.dtype)
        watched = trace.steps <= self._watch and trace.steps % EVERY == 0
        kept = trace.steps < trace.rollout.keep and seen
        if value is None and not framed and (watched or kept):
            value = layout.decode(step.data)
        if watched:
            picture = layout.kind == "array" and is_picture(layout.shape, layout.dtype)
            trace.watched.append(frame_hash(value) if picture else value_hash(value))
            if picture:
                self._widen(value)
        trace.micros += step.micros
        trace.costs.append(step.micros)
        trace.opaque |= layout.opaque
        trace.observations.append(step.digest or self._digest(layout, step.data))
        self._keep_info(step.info)
        if kept and value is not None and not framed and layout.kind != "array":
            self._keep_value(layout, step.data)
        elif kept and value is not None:
            self._keep_frame(trace.frames, layout, value)

    def _widen(self, picture: NDArray[np.uint8]) -> None:
        """Widen the range of each channel by those of a picture."""
        trace = self.trace
        low, high = (np.atleast_1d(extreme(picture, axis=(0, 1))).tolist() for extreme in (np.min, np.max))
        known = trace.ranges or list(zip(low, high, strict=True))
        # Pictures with other channels: the check api reports them.
        trace.ranges = [
            (min(least, each), max(most, every)) for (least, most), each, every in zip(known, low, high, strict=False)
        ]

    def _decode(self, number: int, data: memoryview, digest: bytes) -> Any:
        """The value of some bytes: of a frame its picture; None where none was to be sent."""
        layout = self._layout(number)
        self._check_framed(number, digest)
        if not digest:
            return layout.decode(data)
        if is_shown(self.pictures, self.trace.steps) != bool(len(data)):
            raise MalformedValue("a picture that was not requested, or none that was")
        if not len(data):
            return None
        colours = len(layout.shape) == 3 and layout.shape[2] == 3
        shape = (*self._resize, 3) if self._resize is not None and colours else layout.shape
        if len(data) != math.prod(shape):
            raise MalformedValue(f"{len(data)} bytes for a picture of shape {shape}")
        return np.frombuffer(data, np.uint8).reshape(shape)

    def _check_framed(self, number: int, digest: bytes) -> None:
        if self._framed[number] != bool(digest):
            raise MalformedValue(f"{self._layout(number)} in the form of another one")

    def _digest(self, layout: ValueCodec, data: memoryview) -> bytes:
        last = self._digested
        if last is None or last[0] is not data or last[1] is not layout:
            last = self._digested = data, layout, self._digest_of(layout, data)
        return last[2]

    def _digest_of(self, layout: ValueCodec, data: memoryview) -> bytes:
        # Only the contract's own space promises the dtype, and no comparison reports what nothing promises.
        plain = None if self._exact_space else layout.plain(data)
        if plain is None:
            return xxhash.xxh3_128_digest(data, layout.tag)
        return xxhash.xxh3_128_digest(plain, layout.plain_tag)

    def _keep_frame(self, frames: list[NDArray[Any]], layout: ValueCodec, value: Any) -> None:
        numbers = layout.kind == "array" and value.dtype.kind in "biuf"
        wanted = numbers and self.trace.steps < self.trace.rollout.keep
        if wanted and self._frames + value.nbytes <= _MAX_FRAMES:
            self._frames += value.nbytes
            frames.append(np.array(value))

    def _keep_value(self, layout: ValueCodec, data: memoryview) -> None:
        if self._frames + layout.size <= _MAX_FRAMES:
            self._frames += layout.size
            # The bytes of a message do not outlive it.
            self.trace.values.append(layout.decode(bytes(data)))

    def _keep_info(self, info: bytes) -> None:
        infos = self.trace.infos
        if infos and infos[-1] == info:
            # Most environments repeat their info, so the steps share one object.
            infos.append(infos[-1])
            return
        if infos and self._infos > _MAX_INFOS:
            infos[-1] = info_digest(infos[-1])
        self._infos += len(info)
        infos.append(info)

    def _problems(self, layout: ValueCodec, value: Any) -> list[tuple[str, str]]:
        space = self._observation_space
        if layout.kind == "other" and (space is None or space.known):
            return [("type", f"the observation is {layout}")]
        if space is None:
            return []
        problems = [validate(space, value, exact=self._exact_space)]
        numbers = layout.kind in ("array", "scalar") and layout.dtype is not None and layout.dtype.kind in "biuf"
        if problems[0] and isinstance(space, Box) and numbers and layout.dtype != space.dtype:
            # validate() reports the wrong dtype and does not get to the range.
            problems.append(validate_range(space, value, exact=self._exact_space))
        return list(dict.fromkeys(problem for problem in problems if problem))

    def _is_any_frame(self, layout: ValueCodec, framed: bool) -> bool:
        """Whether every value of this layout is in the space: the usual case of uint8 frames with bounds 0 and 255."""
        if framed and self._resize is not None:
            return self.frame is not None and len(layout.shape) == 3 and layout.shape[2] == 3
        space = self._observation_space
        return (
            isinstance(space, Box)
            and layout.kind == "array"
            and layout.dtype == space.dtype
            and layout.shape == space.shape
            and space.spans_dtype
        )

    def _frame_shape(self, space: SpaceSpec | None, resize: tuple[int, int] | None) -> tuple[int, ...] | None:
        if not isinstance(space, Box) or np.dtype(space.dtype) != np.uint8 or not space.spans_dtype:
            return None
        return space.shape if resize is None or space.shape == (*resize, 3) else None

    def _layout(self, number: int) -> ValueCodec:
        try:
            return self._layouts[number]
        except IndexError:
            raise MalformedValue(f"layout {number} was never described") from None

    def _note_render(self, problem: Problem) -> None:
        if len(self.trace.render_problems) < _MAX_PROBLEMS:
            self.trace.render_problems.append(problem)


class MeasuredTraceBuilder(TraceBuilder):
    """Builds the trace of an episode that may stop when its time is over."""

    def end(self) -> None:
        if not self.trace.observations:
            super().end()


def _thin(value: Any) -> Any:
    """Downsample a rendered frame; return any other value unchanged."""
    if not isinstance(value, np.ndarray) or value.ndim != 3:
        return value
    step = -(-max(value.shape[:2]) // _RENDERED_SIDE) or 1
    return value[::step, ::step]
