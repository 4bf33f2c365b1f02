"""The layer ``behavioural``: the same game, however it is written.

What an environment does is known from the sandbox: of one episode that every audit plays (random actions, each held for
a while, on the first seed, which are the same for all environments with one action space), the first 256 steps are a
*fingerprint*: a perceptual hash of every fourth observation (:mod:`.perceptual`), the sum of the rewards between two of
them, and when and how the episode ended. Two environments are the same here if they were given the same actions, ended
alike, were paid the same between all frames, and their hashes agree in 19 of 20 bits: a game written anew, in other
words or other colours. One that draws its random numbers in another order has other levels, and is another game here.

An environment has no key if a check did not ask for the episode or it did not come through whole, if it is over within
eight steps, if most of its frames are blank, or if neither frames nor rewards ever change: nothing of that says what it
is, and broken environments would all be the same.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import struct
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from .perceptual import BLANK

if TYPE_CHECKING:
    from envcraft.trace import Trace

#: So many steps are looked at, and every so many-th observation.
STEPS, EVERY = 256, 4
#: A shorter episode has no key.
FEWEST = 8
#: The share of bits in which the frames of the same game agree.
AGREE = 0.95
_VERSION = 1
_HEAD = struct.Struct("<BBHH8s")
_ENDS = {"terminated": 1, "truncated": 2}


class Series(msgspec.Struct, frozen=True):
    """A fingerprint, read.

    Attributes:
        script: a digest of the seed and the actions: only what was given the same can be compared.
        end: 1 terminated, 2 truncated, 0 still going on.
        steps: how many of :data:`STEPS` there were.
        frames: hashes of the observations at the reset and every :data:`EVERY` steps, shape ``(F,)``, uint64.
        rewards: their sum between these, and from the last one to the end, shape ``(R,)``, to four decimals.
    """

    script: bytes
    end: int
    steps: int
    frames: NDArray[np.uint64]
    rewards: NDArray[np.float32]

    @property
    def told(self) -> tuple[bytes, int, int, bytes]:
        """What two of the same game have in common to the bit."""
        return self.script, self.end, self.steps, self.rewards.tobytes()

    @property
    def telling(self) -> bool:
        """Whether it says anything about the game."""
        blank = np.count_nonzero(self.frames == BLANK) > len(self.frames) / 2
        still = bool((self.frames == self.frames[0]).all() and (self.rewards == self.rewards[0]).all())
        return self.steps >= FEWEST and not blank and not still


def fingerprint(trace: Trace) -> str:
    """The fingerprint of an episode of which the first :data:`STEPS` were watched, in base64."""
    steps = min(trace.steps, STEPS)
    frames = np.array(trace.watched, "<u8")
    sums = [sum(trace.rewards[start : min(start + EVERY, steps)]) for start in range(0, steps, EVERY)]
    with np.errstate(over="ignore"):
        # Adding makes one zero of two.
        rewards = np.round(np.array(sums, np.float64), 4).astype("<f4") + np.float32(0)
    end = _ENDS.get(trace.ending.value, 0) if trace.steps <= STEPS else 0
    script = hashlib.blake2b(
        msgspec.json.encode((trace.rollout.seed, trace.rollout.actions[:STEPS])), digest_size=8
    ).digest()
    head = _HEAD.pack(_VERSION, end, steps, len(frames), script)
    return base64.b64encode(head + frames.tobytes() + rewards.tobytes()).decode()


def read(text: str) -> Series | None:
    """What :func:`fingerprint` wrote; None where it is none of this version, or tells nothing."""
    try:
        data = base64.b64decode(text, validate=True)
        version, end, steps, count, script = _HEAD.unpack_from(data)
        whole = version == _VERSION and len(data) == _HEAD.size + 8 * count + 4 * -(-steps // EVERY)
        if not whole or not count or not steps:
            return None
        frames = np.frombuffer(data, "<u8", count, _HEAD.size)
        series = Series(script, end, steps, frames, np.frombuffer(data, "<f4", -1, _HEAD.size + 8 * count))
    except (binascii.Error, struct.error, ValueError):
        return None
    return series if series.telling else None


def pairs(found: Sequence[Series]) -> Iterator[tuple[int, int]]:
    """Pairs of the same game, each with the first that it is the same as."""
    alike: dict[Any, list[int]] = {}
    for number, series in enumerate(found):
        alike.setdefault((*series.told, len(series.frames)), []).append(number)
    for numbers in alike.values():
        signs = _signs([found[number].frames for number in numbers])
        for place in range(1, len(numbers)):
            agree = (signs[:place] @ signs[place] / signs.shape[1] + 1) / 2
            yield from ((numbers[first], numbers[place]) for first in np.flatnonzero(agree >= AGREE).tolist())


def kernel(found: Sequence[Series]) -> NDArray[np.float64]:
    """How alike all pairs are: the mean over their frames of how far the hashes agree (1 all bits, 0 half of them),
    counted only where the reward before was the same; 0 under other actions.

    Episodes of different lengths agree in no more than the shorter one has, over the geometric mean of both. Each
    factor is an inner product, so that the result is positive semidefinite.
    """
    count = len(found)
    total = np.zeros((count, count))
    lengths = np.array([len(series.frames) for series in found])
    scripts = np.array([int.from_bytes(series.script, "big") for series in found], np.uint64)
    for place in range(max(lengths, default=0)):
        there = np.flatnonzero(lengths > place).tolist()
        signs = _signs([found[number].frames[place : place + 1] for number in there])
        agree = (signs @ signs.T).astype(np.float64) / 64
        if place:
            rewards = np.array([found[number].rewards[place - 1] for number in there]).view(np.uint32)
            agree *= rewards[:, None] == rewards
        total[np.ix_(there, there)] += agree
    ends = [series.told[1:3] for series in found]
    _, kinds = np.unique(np.array(ends).reshape(count, 2), axis=0, return_inverse=True)
    kinds = kinds.ravel()
    total += kinds[:, None] == kinds
    total *= scripts[:, None] == scripts
    scale = np.sqrt(lengths + 1.0)
    return np.asarray(total / scale[:, None] / scale)


def _signs(frames: Sequence[NDArray[np.uint64]]) -> NDArray[np.float32]:
    """The bits of hashes as 1 and -1, one row for each, shape ``(len(frames), 64 * hashes)``."""
    bits = np.unpackbits(np.ascontiguousarray(frames).astype("<u8").view(np.uint8).reshape(len(frames), -1), axis=1)
    return bits.astype(np.float32) * 2 - 1
