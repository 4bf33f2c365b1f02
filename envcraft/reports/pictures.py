"""Small pictures of frames in a terminal: each character shows two pixels, one above the other."""

from __future__ import annotations

import io
import os
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.text import Text

    from envcraft.model.frame import Frame

_UPPER_HALF = "▀"
_GAP = "  "


def shows_pictures(output: TextIO) -> bool:
    """Whether a stream is a terminal that says it has 24-bit colours, and the user wants colours."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or not output.isatty():
        return False
    unicode = (output.encoding or "").lower().startswith("utf")
    return unicode and os.environ.get("COLORTERM", "").lower() in ("truecolor", "24bit")


def picture_lines(frame: Frame, lines: int, width: int) -> list[Text]:
    """Draw a frame, beside the expected one if there is one: then both are cut to where they differ.

    Args:
        frame: the frame.
        lines: the maximum height in lines.
        width: the maximum width in characters.

    Returns:
        The lines; none without room for a picture.
    """
    pixels = [_pixels(data) for data in (frame.expected, frame.png) if data]
    if len(pixels) == 2 and pixels[0].shape == pixels[1].shape:
        top, bottom, left, right = _differing(pixels[0], pixels[1], 2 * lines)
        pixels = [each[top:bottom, left:right] for each in pixels]
    room = (width - len(_GAP) * (len(pixels) - 1)) // len(pixels)
    if lines < 1 or room < 1:
        return []
    drawn = [_drawn(each, lines, room) for each in pixels]
    return [row if len(drawn) == 1 else row + _GAP + drawn[1][number] for number, row in enumerate(drawn[0])]


def _pixels(png: bytes) -> NDArray[np.uint8]:
    import numpy as np
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def _differing(one: NDArray[np.uint8], two: NDArray[np.uint8], least: int) -> tuple[int, int, int, int]:
    """The first and last row and column (exclusive) of what differs, with at least so many of both."""
    import numpy as np

    spans = []
    for axis, size in enumerate(one.shape[:2]):
        places = np.flatnonzero((one != two).any(axis=(1 - axis, 2)))
        start, end = (int(places[0]), int(places[-1]) + 1) if len(places) else (0, size)
        start = max(min(start - (least - (end - start)) // 2, size - least), 0) if end - start < least else start
        spans += [start, min(max(end, start + least), size)]
    top, bottom, left, right = spans
    return top, bottom, left, right


def _drawn(pixels: NDArray[np.uint8], lines: int, room: int) -> list[Text]:
    import numpy as np
    from PIL import Image
    from rich.text import Text

    height, width = pixels.shape[:2]
    scale = min(2 * lines / height, room / width, 1.0)
    # Two pixels of one column are one character.
    size = max(int(width * scale), 1), max(int(height * scale) // 2 * 2, 2)
    small = np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))
    rows = []
    for upper, lower in zip(small[::2], small[1::2], strict=True):
        row = Text()
        for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
            row.append(_UPPER_HALF, f"#{bytes(above).hex()} on #{bytes(below).hex()}")
        rows.append(row)
    return rows
