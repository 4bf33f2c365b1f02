"""Pictures of a finding: its reproduction run again in the sandbox, each frame as a PNG file.

Reporters run no code; one that wants pictures is given :class:`FrameRenderer`.
"""

from __future__ import annotations

import struct
import zlib
from types import TracebackType
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.errors import EnvCraftError, Skip
from envcraft.judging.engine import Plan, open_subject
from envcraft.judging.subject import Subject
from envcraft.model.frame import Frame
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.trace import Trace
from envcraft.model.verdict import Finding, SubjectReport
from envcraft.spaces.codec import is_picture
from envcraft.spaces.spec import Box

#: The last so many frames of an episode: what led to the moment.
MOST = 90
#: Reproductions with more steps than this show no frames: a trace keeps the first ones, and the last are wanted.
_STEPS = 1_000
#: Pixels of the longer side; larger frames are thinned out.
_SIDE = 256
_PALETTE = 256


class FrameRenderer:
    """Gives the frames of findings (:data:`envcraft.model.frame.FrameSource`), for `findings` of them at the most.

    Use as a context manager: leaving it ends the workers. The frames of one subject's findings should be asked for in
    a row, since they share its workers.
    """

    def __init__(self, plan: Plan, findings: int = 200) -> None:
        self._plan = plan
        self._targets = {target.path: target for target in plan.targets}
        self._left = findings
        self._subject: Subject | None = None
        self._path = ""

    def __enter__(self) -> FrameRenderer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._close()

    def __call__(self, report: SubjectReport, finding: Finding) -> list[Frame]:
        """The last frames of the finding's reproduction; none where it cannot be played, or shows no picture."""
        target = self._targets.get(report.path)
        if target is None or self._left <= 0 or len(finding.repro.actions) > _STEPS:
            return []
        self._left -= 1
        try:
            conditions = Conditions.from_json(finding.repro.conditions)
            if self._subject is None or self._path != report.path:
                self._close()
                picked = msgspec.structs.replace(target, env_class=target.env_class or report.env_class)
                self._subject, self._path = open_subject(self._plan, picked), report.path
            repro = finding.repro
            conditions = with_frames(self._subject, conditions)
            rollout = Rollout(repro.seed, repro.actions, conditions, player="replay", keep=len(repro.actions) + 1)
            # A rollout would be remembered with all its frames.
            trace = self._subject.rerun(rollout)
        except (EnvCraftError, Skip, msgspec.ValidationError):
            # A report without pictures is better than none.
            return []
        if len(frames_of(trace)) < len(trace.observations):
            # Some were not kept, most likely the last ones.
            return []
        shown = list(enumerate(frames_of(trace)))[-MOST:]
        return [Frame(step, png(picture)) for step, frame in shown if (picture := pixels(frame)) is not None]

    def _close(self) -> None:
        if self._subject is not None:
            self._subject.close()
            self._subject = None


def with_frames(subject: Subject, conditions: Conditions) -> Conditions:
    """`conditions`, with the frames of render() where the observations are no pictures and it gives some."""
    space = subject.observation_space
    pictures = isinstance(space, Box) and is_picture(space.shape, np.dtype(space.dtype))
    return conditions if pictures or not subject.renders else msgspec.structs.replace(conditions, render=True)


def frames_of(trace: Trace) -> list[NDArray[Any]]:
    """The frames that a trace under :func:`with_frames` conditions kept: observations, or what render() gave."""
    pictures = [frame for frame in trace.frames if rgb(frame) is not None]
    return pictures or trace.rendered


def pixels(frame: NDArray[Any]) -> NDArray[np.uint8] | None:
    """A frame as RGB pixels of moderate size, or None where the observation is no picture."""
    thin = -(-max(frame.shape[:2], default=1) // _SIDE) or 1
    return rgb(frame[::thin, ::thin] if frame.ndim > 1 else frame)


def rgb(frame: NDArray[Any]) -> NDArray[np.uint8] | None:
    """A frame as RGB pixels, or None where the observation is no picture."""
    if not is_picture(frame.shape, frame.dtype):
        return None
    grey = frame.ndim == 2 or frame.shape[2] == 1
    return np.repeat(frame.reshape(*frame.shape[:2], 1), 3, axis=2) if grey else frame


def png(picture: NDArray[np.uint8]) -> bytes:
    """Encode RGB pixels as a PNG file, with a palette where 256 colours do."""
    height, width = picture.shape[:2]
    packed = picture.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    colours, indices = np.unique(packed, return_inverse=True)
    if len(colours) <= _PALETTE:
        rows = indices.reshape(height, width).astype(np.uint8)
        palette = np.stack([colours >> 16, colours >> 8, colours], axis=1).astype(np.uint8)
        kind, chunks = 3, _chunk(b"PLTE", palette.tobytes())
    else:
        rows, kind, chunks = picture.reshape(height, -1), 2, b""
    # Each row begins with the number of its filter: 0, none.
    data = np.hstack([np.zeros((height, 1), np.uint8), rows]).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
    chunks = _chunk(b"IHDR", header) + chunks + _chunk(b"IDAT", zlib.compress(data, 9)) + _chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
