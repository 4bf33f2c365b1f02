"""Parse a job's messages on the host: known kinds, bounded lengths and fixed layouts, and no trust beyond them."""

from __future__ import annotations

import json
import struct
from typing import Any

from envcraft_protocol.wire import (
    BLOCK,
    DIGEST,
    FLAGS,
    FRAME,
    HEADER,
    LONG,
    MAX_BLOCK,
    MAX_INFO,
    MAX_JSON,
    MAX_STEPS,
    RENDERED,
    RESOURCES,
    SAME,
    SAME_INFO,
    STEP,
    VALUE,
    Kind,
    Type,
    longest,
)

from envcraft.errors import MalformedValue
from envcraft.judging.driver import Recorder, Steps

_TYPES = [kind.words for kind in Type]
_BOOLS = [False, True]
_NOTHING = memoryview(b"")
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
        reached: a digit for each mark in the source, 1 for those that were reached; empty if the job does not say.
        awaits_action: the job waits for its next action. Only an interactive job may ask, and it chooses no action
            itself. The sender of the action resets it.
        phase: the call that the job last reported.
    """

    def __init__(self, recorder: Recorder, played: bool = False, marks: int = 0) -> None:
        self.ended = False
        self.reusable = False
        self.steps = 0
        self.waits = 0
        self.busy = 0
        self.reached = ""
        self._marks = marks
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
        if kind is Kind.ACTION or (kind is Kind.ASK and not self._played):
            raise Forged(f"{kind.name} in a job whose actions have another source")
        recorder = self._recorder
        if kind is Kind.STEPS:
            recorder.steps(self._block(payload))
        elif kind is Kind.RESET:
            block = self._only(kind, payload)
            step = next(block.each())
            recorder.reset(step)
            if block.rendered[0]:
                recorder.render(step.layout, step.data, step.digest)
        elif kind is Kind.AFTER:
            recorder.after(next(self._only(kind, payload).each()))
        elif kind is Kind.RENDER:
            flags, layout = VALUE.unpack_from(payload)
            if flags & ~(SAME | FRAME):
                raise Forged("a value with unknown flags")
            digest, value = self._value(flags, layout, payload[VALUE.size :])
            recorder.render(layout, value, digest)
        elif kind is Kind.PHASE:
            self.phase = str(_json(payload))[:40]
            recorder.phase(self.phase)
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
            self.reached = end.get("reached", "")
            if self.reached != "" and not _are_digits(self.reached, self._marks):
                raise Forged("marks that the source does not have")
        elif kind is Kind.ASK:
            self.awaits_action = True
        elif kind is Kind.RESOURCES:
            recorder.resources(RESOURCES.unpack(payload))
        elif kind is not Kind.TICK:
            value = _json(payload)
            if not isinstance(value, dict):
                raise Forged(f"{kind.name} is not a JSON object")
            {
                Kind.LAYOUT: recorder.layout,
                Kind.LOADED: recorder.loaded,
                Kind.FAULT: recorder.fault,
                Kind.CHANGED: recorder.changed,
                Kind.SPACE: recorder.space,
                Kind.RESULT: recorder.result,
                Kind.FIELDS: recorder.fields,
            }[kind](value)

    def _value(self, flags: int, layout: int, data: memoryview) -> tuple[bytes, memoryview]:
        """The digest of a frame and its picture, if there is one; of any other value no digest, and its bytes. They are
        the same object as the last time if the value is the last long one again.
        """
        if flags & FRAME:
            if flags & SAME or len(data) < DIGEST:
                raise Forged("a frame without a digest")
            return bytes(data[:DIGEST]), memoryview(bytes(data[DIGEST:]))
        if flags & SAME:
            if len(data) or self._last is None or self._last[0] != layout:
                raise Forged("a value that claims to repeat the last one")
            return b"", self._last[1]
        value = memoryview(bytes(data))
        if len(data) >= LONG:
            self._last = layout, value
        return b"", value

    def _only(self, kind: Kind, payload: memoryview) -> Steps:
        """The block of a message with one record. Raises Forged."""
        block = self._block(payload)
        if len(block) != 1 or block.actions or (kind is Kind.AFTER and block.rendered[0]):
            raise Forged(f"{kind.name} with more than it has")
        return block

    def _block(self, payload: memoryview) -> Steps:
        count, length = BLOCK.unpack_from(payload)
        start = BLOCK.size + count * STEP.size
        if count > MAX_STEPS or length > MAX_JSON or start + length > len(payload):
            raise Forged("a block whose lengths do not add up")
        actions = _json(payload[len(payload) - length :]) if length else []
        if not isinstance(actions, list) or not (count or actions):
            raise Forged("a block without steps and actions")
        if self._played and (actions or count > 1):
            raise Forged("a block in a job whose actions have another source")
        if not count:
            if start + length != len(payload):
                raise Forged("a block whose lengths do not add up")
            return Steps(actions=actions)
        flags, ended, cut, kinds, rewards, micros, layouts, sizes, texts = zip(
            *STEP.iter_unpack(payload[BLOCK.size : start]), strict=True
        )
        values = sum(sizes) + sum(texts)
        if start + values + length != len(payload) or max(texts) > MAX_INFO or (count > 1 and values > MAX_BLOCK):
            raise Forged("a block whose lengths do not add up")
        if max(flags) > FLAGS or max(*ended, *cut, *kinds) >= len(_TYPES):
            raise Forged("a step with unknown flags or types")
        digests, data = self._values(flags, layouts, sizes, payload[start : start + sum(sizes)])
        return Steps(
            terminated=[_BOOLS[flag & 1] for flag in flags],
            truncated=[_BOOLS[flag >> 1 & 1] for flag in flags],
            terminated_types=[_TYPES[kind] for kind in ended],
            truncated_types=[_TYPES[kind] for kind in cut],
            reward_types=[_TYPES[kind] for kind in kinds],
            rewards=list(rewards),
            micros=list(micros),
            layouts=list(layouts),
            digests=digests,
            data=data,
            infos=self._infos(flags, texts, payload[start + sum(sizes) : len(payload) - length]),
            rendered=[_BOOLS[flag & RENDERED != 0] for flag in flags],
            actions=actions,
        )

    def _values(
        self, flags: tuple[int, ...], layouts: tuple[int, ...], sizes: tuple[int, ...], data: memoryview
    ) -> tuple[list[bytes], list[memoryview]]:
        """The digests and the bytes of a block's observations."""
        if min(flags) & FRAME and all(flag & FRAME and not flag & SAME for flag in flags) and set(sizes) == {DIGEST}:
            joined = bytes(data)
            return [joined[at : at + DIGEST] for at in range(0, len(joined), DIGEST)], [_NOTHING] * len(flags)
        digests, values = [], []
        at = 0
        for flag, layout, size in zip(flags, layouts, sizes, strict=True):
            digest, value = self._value(flag, layout, data[at : at + size])
            digests.append(digest)
            values.append(value)
            at += size
        return digests, values

    def _infos(self, flags: tuple[int, ...], sizes: tuple[int, ...], data: memoryview) -> list[bytes]:
        infos = []
        at = 0
        for flag, size in zip(flags, sizes, strict=True):
            if not flag & SAME_INFO:
                self._info = bytes(data[at : at + size])
                at += size
            elif size or self._info is None:
                raise Forged("an info that claims to repeat the last one")
            infos.append(self._info)
        return infos


def _are_digits(reached: object, count: int) -> bool:
    return isinstance(reached, str) and len(reached) == count and set(reached) <= {"0", "1"}


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
