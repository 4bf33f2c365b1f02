"""The decoder for frames in checkpoints of version 0.1, which store them as palettes and runs.

A frame is ``colours - 1`` (1 byte), the palette (3 bytes per colour), and groups of equal rows. A group is the number
of its rows, followed by the index of an equal earlier row, or by 255 and the runs of the row: lengths and colours in
turn, one byte each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_RUNS = 255


def decode(data: NDArray[np.uint8], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Decode a frame of shape [height, width, 3]. Raises ValueError or IndexError for invalid data."""
    height, width, channels = shape
    start = 1 + channels * (int(data[0]) + 1)
    palette = data[1:start].reshape(-1, channels)
    frame = np.empty(shape, np.uint8)
    numbers = data[start:].tolist()
    at = row = 0
    while row < height:
        count, earlier = numbers[at : at + 2]
        at += 2
        if earlier == _RUNS:
            first, pixels = at, 0
            while pixels < width:
                pixels += numbers[at]
                at += 2
            frame[row : row + count] = palette[np.repeat(numbers[first + 1 : at : 2], numbers[first:at:2])]
        else:
            frame[row : row + count] = frame[earlier]
        row += count
    return frame
