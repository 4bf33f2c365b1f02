"""Recorded episodes of the pages: the frames are tiles of one picture, and the rewards and flags are data."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft.corpus.report.media import pillow
from envcraft.judging.frame_renderer import frames_of, pixels
from envcraft.model.trace import Trace
from envcraft.text import one_line

#: The columns of tiles, and the frames of an episode that are kept. Each side stays below the 16,383 pixels of WebP.
COLUMNS, FRAMES = 32, 1_024
#: The pixels of the tiles together.
_PIXELS = 12 * 10**6
#: Lossless, with little effort.
_EFFORT = 1


def tiles(frames: list[NDArray[np.uint8]]) -> bytes:
    """Encode frames of one shape as one lossless WebP picture of tiles, row by row. Needs a Pillow that writes WebP.

    Args:
        frames: RGB frames, each of shape (height, width, 3).
    """
    height, width = frames[0].shape[:2]
    columns = min(len(frames), COLUMNS)
    sheet = np.zeros((math.ceil(len(frames) / columns) * height, columns * width, 3), np.uint8)
    for place, frame in enumerate(frames):
        top, left = place // columns * height, place % columns * width
        sheet[top : top + height, left : left + width] = frame
    written = io.BytesIO()
    pillow().fromarray(sheet).save(written, "WEBP", lossless=True, quality=0, method=_EFFORT)
    return written.getvalue()


def shown(trace: Trace) -> list[NDArray[np.uint8]]:
    """The frames of a trace under conditions with frames that fit one picture, all of the first one's shape."""
    frames = [picture for frame in frames_of(trace) if (picture := pixels(frame)) is not None]
    if not frames or pillow() is None:
        return []
    most = min(FRAMES, max(_PIXELS // (frames[0].shape[0] * frames[0].shape[1]), 1))
    same = [frame for frame in frames if frame.shape == frames[0].shape]
    return same[:most]


def episode(trace: Trace, frames: list[NDArray[np.uint8]], label: str, rate: float, **more: Any) -> dict[str, Any]:
    """The data of an episode for the page, without its picture.

    Args:
        trace: the episode.
        frames: those that the picture has.
        label: a heading.
        rate: steps per second.
        more: further fields.
    """
    height, width = frames[0].shape[:2] if frames else (1, 1)
    words = f"seed {trace.rollout.seed}, {trace.steps:,} steps, {trace.ending.value}"
    if trace.success is not None:
        words += ", success" if trace.success else ", no success"
    if trace.fault is not None:
        words += f": {one_line(trace.fault)}"
    if not frames:
        words += "; it has no picture"
    elif len(frames) <= trace.steps:
        words += f"; the first {len(frames):,} frames"
    return {
        "label": one_line(label),
        "words": words,
        "rewards": [value if math.isfinite(value) else str(value) for value in trace.rewards],
        "ending": trace.ending.value,
        "width": width,
        "height": height,
        "columns": min(len(frames), COLUMNS) or 1,
        "frames": len(frames),
        "rate": rate,
        **more,
    }
