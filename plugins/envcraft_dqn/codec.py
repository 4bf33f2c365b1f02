"""Flat-coloured frames in a few hundred bytes: a palette, runs of one colour, and rows that repeat an earlier row.

A frame of [height, width, 3] bytes becomes::

    colours - 1, 1 byte · palette, 3 bytes a colour · groups of equal rows until all rows are there

A group is the number of its rows, then the number of an earlier row that they equal, or 255 and the runs of the row:
each a length and a colour, a byte each. General codecs make it somewhat smaller, and take several times as long to give
it back, which a learner waits for 64 times an update.

Encoded frames lie in an arena of blocks, each in as many as it needs, one behind the other. A frame takes the first gap
behind the frame before it: in a ring that is where the oldest were.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

_Bytes = NDArray[np.uint8]
_Lengths = NDArray[np.uint16]
_Slots = NDArray[np.int64]
_Starts = NDArray[np.int32]
_Flags = NDArray[np.bool_]

#: What stands where the number of an earlier row may stand.
_RUNS = 255
#: No side is longer: numbers of rows and lengths of runs take a byte.
LONGEST = 254
#: Bytes of a block.
BLOCK = 64
#: Bytes of an encoded frame, at most: what has no flat colours would take more than it had.
LARGEST = 4_096
#: Blocks that are looked at for a gap.
_FAR = 4_096
#: Bytes of one colour that are written at once, whatever the length of the run: sixteen pixels, two moves.
_STRIP = 48
#: Numbers that are counted with, and what numba makes code by: to type checkers anything.
_whole: Any = np.int64
_builders: Any = cgutils


class Arena:
    """Room for `size` frames of `mean` bytes each, and where in there the frame of each slot is.

    Attributes:
        lengths: bytes of each slot's frame, uint16 [size]; 0 where none is in the arena.
    """

    def __init__(self, size: int, mean: int) -> None:
        blocks = max(-(-size * mean // BLOCK), LARGEST // BLOCK)
        self._bytes = np.zeros(blocks * BLOCK, np.uint8)
        self._used = np.zeros(blocks, np.bool_)
        self._starts = np.zeros(size, np.int32)
        self.lengths = np.zeros(size, np.uint16)
        self._behind = 0

    @property
    def nbytes(self) -> int:
        return self._bytes.nbytes + self._used.nbytes + self._starts.nbytes + self.lengths.nbytes

    def write(self, slots: _Slots, frames: _Bytes) -> None:
        """Encode frames [n, height, width, 3]. Those for which there is no room, or which take more than LARGEST bytes
        or have more than 256 colours, are left out, and their lengths are 0.
        """
        given = np.ascontiguousarray(frames)
        self._behind = _write(self._bytes, self._used, self._starts, self.lengths, self._behind, slots, given)

    def read(self, slots: _Slots, frames: _Bytes) -> None:
        """Write the frames in `slots` into `frames`, [n, height, width, 3], but for those whose length is 0."""
        _read(self._bytes, self._starts, self.lengths, slots, frames)

    def dump(self, first: int, end: int) -> _Bytes:
        """The encoded frames of some slots, one behind the other."""
        data = np.empty(int(self.lengths[first:end].sum()), np.uint8)
        _dump(self._bytes, self._starts, self.lengths, first, end, data)
        return data

    def load(self, first: int, lengths: _Lengths, data: _Bytes) -> None:
        """Put back what :meth:`dump` gave, with the lengths of these slots. Raises ValueError if there is no room."""
        arguments = (self._bytes, self._used, self._starts, self.lengths, self._behind)
        self._behind = _load(*arguments, first, lengths, data)


@numba.njit(cache=True, nogil=True)
def _write(
    arena: _Bytes, used: _Flags, starts: _Starts, lengths: _Lengths, behind: int, slots: _Slots, frames: _Bytes
) -> int:
    count, height, width = frames.shape[:3]
    rows = frames.reshape((count, height, 3 * width))
    encoded = np.empty(LARGEST, np.uint8)
    for at in range(count):
        behind = _put(arena, used, starts, lengths, behind, slots[at], encoded, _encode(rows[at], encoded))
    return behind


@numba.njit(cache=True, nogil=True)
def _put(
    arena: _Bytes, used: _Flags, starts: _Starts, lengths: _Lengths, behind: int, slot: int, data: _Bytes, size: int
) -> int:
    """Replace what is in a slot by the first `size` bytes of `data`; give the block behind these."""
    needed = _blocks(size)
    before = -1
    if lengths[slot]:
        before = _whole(starts[slot])
        used[before : before + _blocks(lengths[slot])] = False
        lengths[slot] = 0
    if size == 0:
        return behind
    place = _gap(used, behind, needed)
    if place < 0 and before >= 0:
        # The ring has come to where frames stay, or were loaded in another order: on where the oldest are now.
        place = _gap(used, before, needed)
    if place < 0:
        return behind
    used[place : place + needed] = True
    arena[place * BLOCK : place * BLOCK + size] = data[:size]
    starts[slot], lengths[slot] = place, size
    return place + needed


@numba.njit(cache=True, nogil=True)
def _blocks(size: int) -> int:
    return int((_whole(size) + BLOCK - 1) // BLOCK)


@numba.njit(cache=True, nogil=True)
def _gap(used: _Flags, begin: int, needed: int) -> int:
    """The first of as many blocks in a row that are not used, from `begin` on and round the end; or -1."""
    at, free = begin, 0
    for _ in range(min(len(used), _FAR) + needed):
        if at == len(used):
            at = free = 0
        free = 0 if used[at] else free + 1
        at += 1
        if free == needed:
            return at - needed
    return -1


@numba.njit(cache=True, nogil=True)
def _read(arena: _Bytes, starts: _Starts, lengths: _Lengths, slots: _Slots, frames: _Bytes) -> None:
    height, stride = frames.shape[1], 3 * frames.shape[2]
    flat = frames.reshape(-1)
    strips = np.empty(256 * _STRIP, np.uint8)
    line = np.empty(stride + _STRIP, np.uint8)
    for at in range(len(slots)):
        if lengths[slots[at]]:
            begin = starts[slots[at]] * BLOCK
            encoded = arena[begin : begin + lengths[slots[at]]]
            _decode(encoded, flat, at * height * stride, height, stride, strips, line)


@numba.njit(cache=True, nogil=True)
def _dump(arena: _Bytes, starts: _Starts, lengths: _Lengths, first: int, end: int, data: _Bytes) -> None:
    at = 0
    for slot in range(first, end):
        begin, size = starts[slot] * BLOCK, _whole(lengths[slot])
        data[at : at + size] = arena[begin : begin + size]
        at += size


@numba.njit(cache=True, nogil=True)
def _load(
    arena: _Bytes,
    used: _Flags,
    starts: _Starts,
    lengths: _Lengths,
    behind: int,
    first: int,
    sizes: _Lengths,
    data: _Bytes,
) -> int:
    at = 0
    for number in range(len(sizes)):
        size = _whole(sizes[number])
        behind = _put(arena, used, starts, lengths, behind, first + number, data[at : at + size], size)
        if size and not lengths[first + number]:
            raise ValueError("the replay has no room for what it had")
        at += size
    return behind


def _copying(context: Any, to: Any, to_at: Any, source: Any, source_at: Any, count: Any) -> Any:
    """Copy `count` bytes from one place to another, in arrays of one dimension; these must not overlap. Slices would
    do the same a byte at a time.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        to_type, _, source_type, _, _ = signature.args
        places = [
            builder.gep(context.make_array(kind)(context, builder, array).data, [at])
            for kind, array, at in ((to_type, *values[:2]), (source_type, *values[2:4]))
        ]
        _builders.raw_memcpy(builder, *places, values[4], 1)
        return context.get_dummy_value()

    return types.void(to, types.intp, source, types.intp, types.intp), generate


_copy: Any = intrinsic(_copying)


@numba.njit(cache=True, nogil=True)
def _encode(rows: _Bytes, cell: _Bytes) -> int:
    """Encode a frame [height, 3 * width]; give the bytes, or 0."""
    height, stride = rows.shape
    palette = np.empty(256, np.int64)
    colours = 0
    body = np.empty(len(cell), np.uint8)
    size = 0
    # Each row as one number, so that few rows are compared byte by byte.
    sums = np.empty(height, np.uint64)
    row = 0
    while row < height:
        last = row
        while last + 1 < height and _same(rows[last + 1], rows[row]):
            last += 1
        total = _sum(rows[row])
        sums[row : last + 1] = total
        earlier = 0
        while earlier < row and not (sums[earlier] == total and _same(rows[earlier], rows[row])):
            earlier += 1
        if size + 2 > len(body):
            return 0
        body[size], body[size + 1] = last - row + 1, earlier if earlier < row else _RUNS
        size += 2
        column = 0 if earlier == row else stride
        while column < stride:
            pixel = _pixel(rows[row], column)
            end = column + 3
            while end < stride and _pixel(rows[row], end) == pixel:
                end += 3
            colour = 0
            while colour < colours and palette[colour] != pixel:
                colour += 1
            if colour == colours:
                if colours == 256:
                    return 0
                palette[colour] = pixel
                colours += 1
            if size + 2 > len(body):
                return 0
            body[size], body[size + 1] = (end - column) // 3, colour
            size += 2
            column = end
        row = last + 1
    begin = 1 + 3 * colours
    if begin + size > len(cell):
        return 0
    cell[0] = colours - 1
    for colour in range(colours):
        for channel in range(3):
            cell[1 + 3 * colour + channel] = palette[colour] >> (16 - 8 * channel)
    cell[begin : begin + size] = body[:size]
    return begin + size


@numba.njit(cache=True, nogil=True)
def _pixel(row: _Bytes, at: int) -> int:
    return int((_whole(row[at]) << 16) | (_whole(row[at + 1]) << 8) | _whole(row[at + 2]))


@numba.njit(cache=True, nogil=True)
def _sum(row: _Bytes) -> np.uint64:
    total = np.uint64(0)
    for at in range(0, len(row), 3):
        total = total * np.uint64(0x9E3779B97F4A7C15) + np.uint64(_pixel(row, at) + 1)
    return total


@numba.njit(cache=True, nogil=True)
def _same(one: _Bytes, other: _Bytes) -> bool:
    # To the end whatever is found, and in bytes: so it is done many bytes at a time.
    different = np.uint8(0)
    for at in range(len(one)):
        different = np.uint8(different | (one[at] ^ other[at]))
    return bool(different == 0)


@numba.njit(cache=True, nogil=True)
def _decode(cell: _Bytes, frames: _Bytes, begin: int, height: int, stride: int, strips: _Bytes, line: _Bytes) -> None:
    """Write the frame into `frames` from the byte `begin` on; `strips` and `line` are room to work in."""
    at = 1
    colours = _whole(cell[0]) + 1
    for colour in range(colours):
        for pixel in range(colour * _STRIP, (colour + 1) * _STRIP, 3):
            strips[pixel], strips[pixel + 1], strips[pixel + 2] = cell[at], cell[at + 1], cell[at + 2]
        at += 3
    row = _whole(0)
    while row < height:
        count, earlier = _whole(cell[at]), _whole(cell[at + 1])
        at += 2
        if count == 0 or row + count > height:
            raise ValueError("no frame is in this cell")
        place = begin + row * stride
        if earlier == _RUNS:
            column = _whole(0)
            while column < stride:
                end = min(column + 3 * _whole(cell[at]), stride)
                strip = _whole(cell[at + 1]) * _STRIP
                at += 2
                # What is written behind the end is overwritten by the next run.
                _copy(line, column, strips, strip, _STRIP)
                while column + _STRIP < end:
                    column += _STRIP
                    _copy(line, column, strips, strip, _STRIP)
                column = end
            for number in range(count):
                _copy(frames, place + number * stride, line, 0, stride)
        else:
            for number in range(count):
                _copy(frames, place + number * stride, frames, begin + earlier * stride, stride)
        row += count
