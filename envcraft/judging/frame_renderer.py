"""Pictures of a finding: the reproduction runs again in the sandbox, and each frame becomes a PNG file.

A reporter runs no code of a target. A reporter that shows pictures receives a :class:`FrameRenderer`.
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

#: Maximum number of frames of a finding; they are the last ones of the episode.
MOST = 90
#: Maximum number of steps of a reproduction that is rendered. A trace keeps the first frames, and the last are needed.
_STEPS = 1_000
#: Maximum length of the longer side in pixels; larger frames are downsampled.
_SIDE = 256
_PALETTE = 256


class FrameRenderer:
    """Renders the frames of findings (:data:`envcraft.model.frame.FrameSource`).

    Use it as a context manager: the exit ends the workers. Request the frames of one subject's findings in a row,
    because they share its workers.

    Args:
        plan: the settings under which the findings were made.
        findings: the maximum number of findings that are rendered.
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
        """Return the last frames of the finding's reproduction, or none if it cannot be played or shows no picture."""
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
            # The cache would keep the trace with all its frames.
            trace = self._subject.rerun(rollout)
            plain = self._plain(self._subject, rollout) if "first" in finding.evidence else []
        except (EnvCraftError, Skip, msgspec.ValidationError):
            # A report without pictures is better than none.
            return []
        if len(frames_of(trace)) < len(trace.observations):
            # The trace did not keep all frames, and the missing ones are probably the last.
            return []
        shown = list(enumerate(frames_of(trace)))[-MOST:]
        frames = [(step, png(picture)) for step, frame in shown if (picture := pixels(frame)) is not None]
        expected = {step: png(picture) for step, frame in enumerate(plain) if (picture := pixels(frame)) is not None}
        return [Frame(step, data, expected[step] if expected.get(step, data) != data else b"") for step, data in frames]

    def _plain(self, subject: Subject, rollout: Rollout) -> list[NDArray[Any]]:
        """The frames of the same actions without the conditions that make a difference; none if some are missing."""
        trace = subject.rerun(rollout.under(with_frames(subject, Conditions())))
        frames = frames_of(trace)
        return frames if len(frames) == len(trace.observations) else []

    def _close(self) -> None:
        if self._subject is not None:
            self._subject.close()
            self._subject = None


def with_frames(subject: Subject, conditions: Conditions) -> Conditions:
    """Return `conditions` with the frames of render(), if the observations are not pictures and render() is supported.

    Args:
        subject: the environment.
        conditions: of the rollout to be rendered.
    """
    space = subject.observation_space
    pictures = isinstance(space, Box) and is_picture(space.shape, np.dtype(space.dtype))
    return conditions if pictures or not subject.renders else msgspec.structs.replace(conditions, render=True)


def frames_of(trace: Trace) -> list[NDArray[Any]]:
    """Return the frames of a trace under :func:`with_frames` conditions: observations or the results of render()."""
    pictures = [frame for frame in trace.frames if rgb(frame) is not None]
    return pictures or trace.rendered


def pixels(frame: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Return a downsampled frame as RGB pixels, or None if the observation is not a picture."""
    thin = -(-max(frame.shape[:2], default=1) // _SIDE) or 1
    return rgb(frame[::thin, ::thin] if frame.ndim > 1 else frame)


def rgb(frame: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Return a frame as RGB pixels, or None if the observation is not a picture."""
    if not is_picture(frame.shape, frame.dtype):
        return None
    grey = frame.ndim == 2 or frame.shape[2] == 1
    return np.repeat(frame.reshape(*frame.shape[:2], 1), 3, axis=2) if grey else frame


def png(picture: NDArray[np.uint8]) -> bytes:
    """Encode RGB pixels as a PNG file, with a palette if there are at most 256 colours.

    Args:
        picture: pixels of shape (height, width, 3).
    """
    height, width = picture.shape[:2]
    packed = picture.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    colours, indices = np.unique(packed, return_inverse=True)
    if len(colours) <= _PALETTE:
        rows = indices.reshape(height, width).astype(np.uint8)
        palette = np.stack([colours >> 16, colours >> 8, colours], axis=1).astype(np.uint8)
        kind, chunks = 3, _chunk(b"PLTE", palette.tobytes())
    else:
        rows, kind, chunks = picture.reshape(height, -1), 2, b""
    # Each row begins with the number of its filter; 0 is none.
    data = np.hstack([np.zeros((height, 1), np.uint8), rows]).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
    chunks = _chunk(b"IHDR", header) + chunks + _chunk(b"IDAT", zlib.compress(data, 9)) + _chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
