"""Flat-coloured frames in a few hundred bytes: a palette, runs of one colour, and rows that repeat an earlier row.

A frame of [height, width, 3] bytes becomes::

    colours - 1, 1 byte · palette, 3 bytes a colour · groups of equal rows until all rows are there

A group is the number of its rows, then the number of an earlier row that they equal, or 255 and the runs of the row:
each a length and a colour, a byte each. General codecs make it somewhat smaller, and take several times as long to give
it back, which a learner waits for 64 times an update.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_Bytes = NDArray[np.uint8]

#: What stands where the number of an earlier row may stand.
_RUNS = 255
#: No side is longer: numbers of rows and lengths of runs take a byte.
LONGEST = 254


@numba.njit(cache=True, nogil=True)
def encode(frames: _Bytes, slots: NDArray[np.int64], cells: _Bytes, lengths: NDArray[np.uint16]) -> None:
    """Encode frames [n, height, width, 3] into the rows `slots` of `cells`; ``lengths[slot]`` is set to the bytes, or
    to 0 where a frame takes more than a cell has or more than 256 colours.
    """
    for at in range(len(frames)):
        lengths[slots[at]] = _encode(frames[at], cells[slots[at]])


@numba.njit(cache=True, nogil=True)
def decode(cells: _Bytes, lengths: NDArray[np.uint16], slots: NDArray[np.int64], frames: _Bytes) -> None:
    """Write the frames in the rows `slots` of `cells` into `frames`, [n, height, width, 3]; those whose length is 0
    are left out. Raises ValueError on a cell that holds none.
    """
    for at in range(len(slots)):
        if lengths[slots[at]]:
            _decode(cells[slots[at]], frames[at])


@numba.njit(cache=True, nogil=True)
def _encode(frame: _Bytes, cell: _Bytes) -> int:
    height, width = frame.shape[0], frame.shape[1]
    palette = np.empty((256, 3), np.uint8)
    colours = 0
    body = np.empty(len(cell), np.uint8)
    size = 0
    # Each row as one number, so that few rows are compared byte by byte.
    sums = np.empty(height, np.uint64)
    row = 0
    while row < height:
        sums[row] = _row_sum(frame[row])
        last = row
        while last + 1 < height and _same(frame[last + 1], frame[row]):
            last += 1
            sums[last] = sums[row]
        earlier = _RUNS
        for other in range(row):
            if sums[other] == sums[row] and _same(frame[other], frame[row]):
                earlier = other
                break
        if size + 2 > len(body):
            return 0
        body[size], body[size + 1] = last - row + 1, earlier
        size += 2
        column = 0
        while earlier == _RUNS and column < width:
            end = column + 1
            while (
                end < width
                and frame[row, end, 0] == frame[row, column, 0]
                and frame[row, end, 1] == frame[row, column, 1]
                and frame[row, end, 2] == frame[row, column, 2]
            ):
                end += 1
            colour = 0
            while colour < colours and not _same_colour(palette[colour], frame[row, column]):
                colour += 1
            if colour == colours:
                if colours == 256:
                    return 0
                palette[colour] = frame[row, column]
                colours += 1
            if size + 2 > len(body):
                return 0
            body[size], body[size + 1] = end - column, colour
            size += 2
            column = end
        row = last + 1
    begin = 1 + 3 * colours
    if begin + size > len(cell):
        return 0
    cell[0] = colours - 1
    for colour in range(colours):
        for channel in range(3):
            cell[1 + 3 * colour + channel] = palette[colour, channel]
    cell[begin : begin + size] = body[:size]
    return begin + size


@numba.njit(cache=True, nogil=True)
def _row_sum(row: _Bytes) -> np.uint64:
    total = np.uint64(0)
    for column in range(row.shape[0]):
        pixel = (np.uint64(row[column, 0]) << np.uint64(16)) | (np.uint64(row[column, 1]) << np.uint64(8))
        total = total * np.uint64(0x9E3779B97F4A7C15) + (pixel | np.uint64(row[column, 2])) + np.uint64(1)
    return total


@numba.njit(cache=True, nogil=True)
def _same(one: _Bytes, other: _Bytes) -> bool:
    for column in range(one.shape[0]):
        for channel in range(3):
            if one[column, channel] != other[column, channel]:
                return False
    return True


@numba.njit(cache=True, nogil=True)
def _same_colour(one: _Bytes, other: _Bytes) -> bool:
    return bool(one[0] == other[0] and one[1] == other[1] and one[2] == other[2])


@numba.njit(cache=True, nogil=True)
def _decode(cell: _Bytes, frame: _Bytes) -> None:
    height, width = frame.shape[0], frame.shape[1]
    at = 1 + 3 * (np.int64(cell[0]) + 1)
    row = np.int64(0)
    while row < height:
        count, earlier = np.int64(cell[at]), np.int64(cell[at + 1])
        at += 2
        if count == 0:
            raise ValueError("no frame is in this cell")
        first = row
        if earlier == _RUNS:
            column = np.int64(0)
            while column < width:
                end = column + np.int64(cell[at])
                place = 1 + 3 * np.int64(cell[at + 1])
                at += 2
                red, green, blue = cell[place], cell[place + 1], cell[place + 2]
                while column < end:
                    frame[row, column, 0], frame[row, column, 1], frame[row, column, 2] = red, green, blue
                    column += 1
            earlier = row
            first += 1
        for copy in range(first, row + count):
            frame[copy] = frame[earlier]
        row += count
