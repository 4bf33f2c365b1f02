"""Parse a job's messages on the host: known kinds, bounded lengths and fixed layouts, and no trust beyond them."""

from __future__ import annotations

import json
import struct
from typing import Any

from envcraft_protocol.wire import HEADER, LONG, MAX_INFO, SAME, SAME_INFO, STEP, VALUE, Kind, Type, longest

from envcraft.errors import MalformedValue
from envcraft.judging.driver import Recorder, Step, Steps

_TYPES = [kind.words for kind in Type]
#: The flags of a step without a new value or info, and all known flags.
_NEITHER = SAME | SAME_INFO
_FLAGS = 1 | 2 | _NEITHER
_KINDS = {int(kind): kind for kind in Kind}


class Forged(ValueError):
    """Bytes that the worker would not have sent."""


class Reader:
    """Cuts a byte stream into messages and passes them to a recorder.

    Attributes:
        ended: the END message has arrived.
        reusable: the process offers to run another job.
        steps: the number of calls of step() that the job reported at its end.
        waits: the number of calls that gave up the processor, of a job that is measured.
        busy: the processor time of the steps in microseconds, of such a job.
        awaits_action: the job waits for its next action. Only an interactive job may ask, and it chooses no action
            itself. The sender of the action resets it.
        phase: the call that the job last reported.
    """

    def __init__(self, recorder: Recorder, played: bool = False) -> None:
        self.ended = False
        self.reusable = False
        self.steps = 0
        self.waits = 0
        self.busy = 0
        self.awaits_action = False
        self._played = played
        self.phase = "start"
        self._recorder = recorder
        self._buffer = bytearray()
        #: The number of the last long value's layout, and the value.
        self._last: tuple[int, memoryview] | None = None
        #: The info of the last step or reset.
        self._info: bytes | None = None

    def feed(self, data: bytes | memoryview) -> None:
        """Parse more bytes. Raises Forged; exceptions of the recorder (Stop) propagate."""
        buffer = self._buffer
        buffer += data
        offset, size = 0, len(buffer)
        try:
            with memoryview(buffer) as view:
                while size - offset >= HEADER.size:
                    kind, length = HEADER.unpack_from(view, offset)
                    if length > longest(kind):
                        raise Forged(f"a message of {length} bytes")
                    start = offset + HEADER.size
                    if size - start < length:
                        break
                    with view[start : start + length] as payload:
                        self._message(kind, payload)
                    offset = start + length
        except (MalformedValue, struct.error, UnicodeDecodeError, RecursionError) as error:
            raise Forged(str(error)) from None
        del buffer[:offset]

    def _message(self, number: int, payload: memoryview) -> None:
        kind = _KINDS.get(number)
        if kind is None:
            raise Forged(f"message kind {number}")
        if self.ended:
            raise Forged("a message after the end")
        if self.awaits_action:
            raise Forged("a message while it waits for an action")
        if (kind is Kind.ASK and not self._played) or (kind in (Kind.ACTION, Kind.STEPS) and self._played):
            raise Forged(f"{kind.name} in a job whose actions have another source")
        recorder = self._recorder
        if kind is Kind.STEP:
            recorder.step(self._step(payload))
        elif kind is Kind.STEPS:
            recorder.steps(self._steps(payload))
        elif kind is Kind.RESET:
            recorder.reset(self._step(payload))
        elif kind is Kind.AFTER:
            recorder.after(self._step(payload))
        elif kind in (Kind.RENDER, Kind.REREAD):
            flags, layout = VALUE.unpack_from(payload)
            value = self._value(flags, layout, payload[VALUE.size :])
            (recorder.render if kind is Kind.RENDER else recorder.reread)(layout, value)
        elif kind is Kind.PHASE:
            self.phase = str(_json(payload))[:40]
            recorder.phase(self.phase)
        elif kind is Kind.ACTION:
            recorder.action(_json(payload))
        elif kind is Kind.ACTED:
            recorder.acted(_json(payload))
        elif kind is Kind.END:
            recorder.end()
            self.ended = True
            end = _json(payload)
            if not isinstance(end, dict):
                raise Forged("END is not a JSON object")
            self.steps, self.waits, self.busy = _count(end, "steps"), _count(end, "waits"), _count(end, "busy")
            self.reusable = end.get("reusable") is True
        elif kind is Kind.ASK:
            self.awaits_action = True
        elif kind is not Kind.TICK:
            value = _json(payload)
            if not isinstance(value, dict):
                raise Forged(f"{kind.name} is not a JSON object")
            {
                Kind.LAYOUT: recorder.layout,
                Kind.LOADED: recorder.loaded,
                Kind.FAULT: recorder.fault,
                Kind.RESULT: recorder.result,
            }[kind](value)

    def _value(self, flags: int, layout: int, data: memoryview) -> memoryview:
        """The bytes of a value; the same object as the last time if the value is the last long one again."""
        if flags:
            if flags != SAME or len(data) or self._last is None or self._last[0] != layout:
                raise Forged("a value that claims to repeat the last one")
            return self._last[1]
        value = memoryview(bytes(data))
        if len(data) >= LONG:
            self._last = layout, value
        return value

    def _step(self, payload: memoryview) -> Step:
        flags, ended_type, cut_type, reward_type, reward, micros, layout, size, info_size = STEP.unpack_from(payload)
        start = STEP.size
        if len(payload) != start + size + info_size or info_size > MAX_INFO or flags > _FLAGS:
            raise Forged("a step whose lengths do not add up")
        if max(ended_type, cut_type, reward_type) >= len(_TYPES):
            raise Forged("a step with an unknown type")
        if not flags & SAME_INFO:
            self._info = bytes(payload[start + size :])
        elif info_size or self._info is None:
            raise Forged("an info that claims to repeat the last one")
        return Step(
            terminated=bool(flags & 1),
            truncated=bool(flags & 2),
            terminated_type=_TYPES[ended_type],
            truncated_type=_TYPES[cut_type],
            reward_type=_TYPES[reward_type],
            reward=reward,
            micros=micros,
            layout=layout,
            data=self._value(flags & SAME, layout, payload[start : start + size]),
            info=self._info,
        )

    def _steps(self, payload: memoryview) -> Steps:
        if not payload or self._last is None or self._info is None:
            raise Forged("repeated steps without an earlier step")
        flags, ended, cut, kinds, rewards, micros, layouts, sizes, infos = zip(*STEP.iter_unpack(payload), strict=True)
        if any(sizes) or any(infos) or set(layouts) != {self._last[0]} or min(flags) < _NEITHER or max(flags) > _FLAGS:
            raise Forged("repeated steps with new values")
        if max(*ended, *cut, *kinds) >= len(_TYPES):
            raise Forged("a step with an unknown type")
        return Steps(
            terminated=[bool(flag & 1) for flag in flags],
            truncated=[bool(flag & 2) for flag in flags],
            terminated_types=[_TYPES[kind] for kind in ended],
            truncated_types=[_TYPES[kind] for kind in cut],
            reward_types=[_TYPES[kind] for kind in kinds],
            rewards=list(rewards),
            micros=list(micros),
            layout=self._last[0],
            data=self._last[1],
            info=self._info,
        )


def _count(end: dict[str, Any], name: str) -> int:
    count = end.get(name, 0)
    if type(count) is not int or not 0 <= count < 2**32:
        raise Forged(f"an impossible number of {name}")
    return count


def _json(payload: memoryview) -> Any:
    try:
        return json.loads(bytes(payload))
    except ValueError as error:
        raise Forged(f"broken JSON: {error}") from None
