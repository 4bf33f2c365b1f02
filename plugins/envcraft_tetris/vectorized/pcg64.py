"""The methods of NumPy's ``Generator`` over PCG64 that the family uses, bit for bit.

Sources: M. E. O'Neill, "PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for Random Number
Generation", 2014 (PCG XSL RR 128/64); D. Lemire, "Fast Random Integer Generation in an Interval", 2019.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft_tetris.vectorized.jit import jit

#: The words of a state: both halves of the number and of its increment, whether half a draw is buffered, and that half.
HIGH, LOW, STEP_HIGH, STEP_LOW, BUFFERED, HALF = range(6)
_WORD = (1 << 64) - 1
_32 = np.uint64(32)
_LOWER = np.uint64(0xFFFFFFFF)
_TIMES_HIGH, _TIMES_LOW = np.uint64(0x2360ED051FC65DA4), np.uint64(0x4385DF649FCCF645)


def state_of(generator: np.random.Generator) -> list[int]:
    """The state of a generator over PCG64 as six 64-bit words."""
    state: Any = generator.bit_generator.state
    number, step = state["state"]["state"], state["state"]["inc"]
    return [number >> 64, number & _WORD, step >> 64, step & _WORD, state["has_uint32"], state["uinteger"]]


@jit
def _high_product(one: Any, two: Any) -> Any:
    """The upper 64 bits of the product of two 64-bit numbers."""
    one_low, one_high, two_low, two_high = one & _LOWER, one >> _32, two & _LOWER, two >> _32
    low = one_low * two_low
    crossed = one_high * two_low + (low >> _32)
    middle = one_low * two_high + (crossed & _LOWER)
    return one_high * two_high + (crossed >> _32) + (middle >> _32)


@jit
def _next64(state: NDArray[np.uint64]) -> Any:
    high, low = state[HIGH], state[LOW]
    high = _high_product(low, _TIMES_LOW) + high * _TIMES_LOW + low * _TIMES_HIGH
    low = low * _TIMES_LOW
    total = low + state[STEP_LOW]
    high = high + state[STEP_HIGH] + np.uint64(total < low)
    state[HIGH], state[LOW] = high, total
    mixed, turn = high ^ total, high >> np.uint64(58)
    return (mixed >> turn) | (mixed << ((np.uint64(64) - turn) & np.uint64(63)))


@jit
def _next32(state: NDArray[np.uint64]) -> Any:
    if state[BUFFERED]:
        state[BUFFERED] = np.uint64(0)
        return state[HALF]
    drawn = _next64(state)
    state[BUFFERED], state[HALF] = np.uint64(1), drawn >> _32
    return drawn & _LOWER


@jit
def integer(state: NDArray[np.uint64], count: int) -> Any:
    """``generator.integers(count)``; also one element of an array of them. If `count` is 1, nothing is drawn."""
    if count == 1:
        return 0
    below = np.uint64(count)
    product = _next32(state) * below
    if (product & _LOWER) < below:
        least = (_LOWER - np.uint64(count - 1)) % below
        while (product & _LOWER) < least:
            product = _next32(state) * below
    return np.int64(product >> _32)


@jit
def permute(state: NDArray[np.uint64], numbers: NDArray[np.int64], count: int) -> None:
    """Write ``generator.permutation(count)`` into the array."""
    for number in range(count):
        numbers[number] = number
    for last in range(count - 1, 0, -1):
        mask = last
        for shift in (1, 2, 4, 8):
            mask |= mask >> shift
        other = np.int64(_next32(state)) & mask
        while other > last:
            other = np.int64(_next32(state)) & mask
        numbers[last], numbers[other] = numbers[other], numbers[last]
