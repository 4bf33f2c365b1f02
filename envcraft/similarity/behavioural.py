"""The layer ``behavioural``: games that behave the same.

Every audit plays one episode of random actions, each held for some steps, on the first seed. All environments with the
same action space receive the same actions. A *fingerprint* describes the first 256 steps: a perceptual hash of every
fourth observation (:mod:`.perceptual`), the sum of the rewards between two of these, and the step and kind of the end.
Two environments are equal in this layer if they received the same actions, ended alike, paid the same rewards between
all frames, and 19 of 20 bits of their hashes agree. This covers a game that was rewritten, or has other colours. A game
that draws its random numbers in another order has other levels, and counts as another game.

An environment has no key if no check requested the episode, if the episode has a fault or at most eight steps, if most
of its frames are blank, or if neither frames nor rewards change. Otherwise all broken environments would be equal.
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

from envcraft.similarity.perceptual import BLANK

if TYPE_CHECKING:
    from envcraft.model.trace import Trace

#: Steps that a fingerprint covers, and the distance between two observations in it.
STEPS, EVERY = 256, 4
#: The steps of the shortest episode with a key.
FEWEST = 8
#: The share of equal bits from which the frames of two games count as the same.
AGREE = 0.95
_VERSION = 1
_HEAD = struct.Struct("<BBHH8s")
_ENDS = {"terminated": 1, "truncated": 2}


class Series(msgspec.Struct, frozen=True):
    """The content of a fingerprint.

    Attributes:
        script: a digest of the seed and the actions; only episodes with the same script are comparable.
        end: 1 terminated, 2 truncated, 0 not ended.
        steps: steps of the episode, at most :data:`STEPS`.
        frames: hashes of the observations at the reset and every :data:`EVERY` steps, shape ``(F,)``, uint64.
        rewards: sums between these observations, the last up to the end, shape ``(R,)``, to four decimals.
    """

    script: bytes
    end: int
    steps: int
    frames: NDArray[np.uint64]
    rewards: NDArray[np.float32]

    @property
    def exact_part(self) -> tuple[bytes, int, int, bytes]:
        """The fields that must be equal for two fingerprints of the same game."""
        return self.script, self.end, self.steps, self.rewards.tobytes()

    @property
    def informative(self) -> bool:
        """Whether the fingerprint identifies a game."""
        blank = np.count_nonzero(self.frames == BLANK) > len(self.frames) / 2
        still = bool((self.frames == self.frames[0]).all() and (self.rewards == self.rewards[0]).all())
        return self.steps >= FEWEST and not blank and not still


def fingerprint(trace: Trace) -> str:
    """The fingerprint of an episode whose first :data:`STEPS` steps were hashed, in base64."""
    steps = min(trace.steps, STEPS)
    frames = np.array(trace.watched, "<u8")
    sums = [sum(trace.rewards[start : min(start + EVERY, steps)]) for start in range(0, steps, EVERY)]
    with np.errstate(over="ignore"):
        # Adding 0 turns -0.0 into 0.0.
        rewards = np.round(np.array(sums, np.float64), 4).astype("<f4") + np.float32(0)
    end = _ENDS.get(trace.ending.value, 0) if trace.steps <= STEPS else 0
    script = hashlib.blake2b(
        msgspec.json.encode((trace.rollout.seed, trace.rollout.actions[:STEPS])), digest_size=8
    ).digest()
    head = _HEAD.pack(_VERSION, end, steps, len(frames), script)
    return base64.b64encode(head + frames.tobytes() + rewards.tobytes()).decode()


def read(text: str) -> Series | None:
    """Read the text of :func:`fingerprint`; None for another version, or if it identifies no game."""
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
    return series if series.informative else None


def pairs(found: Sequence[Series]) -> Iterator[tuple[int, int]]:
    """Yield the indices of each two fingerprints of the same game, the lower first."""
    alike: dict[Any, list[int]] = {}
    for number, series in enumerate(found):
        alike.setdefault((*series.exact_part, len(series.frames)), []).append(number)
    for numbers in alike.values():
        signs = _signs([found[number].frames for number in numbers])
        for place in range(1, len(numbers)):
            agree = (signs[:place] @ signs[place] / signs.shape[1] + 1) / 2
            yield from ((numbers[first], numbers[place]) for first in np.flatnonzero(agree >= AGREE).tolist())


def kernel(found: Sequence[Series]) -> NDArray[np.float64]:
    """The similarity of all pairs of fingerprints.

    It is the mean agreement of their hashes over the frames (1 for all bits, 0 for half of them), counted only if the
    rewards before a frame are equal, and 0 for different scripts. Episodes of different lengths share at most the
    frames of the shorter one, divided by the geometric mean of both lengths.

    Returns:
        A matrix of shape ``(n, n)``. Each factor is an inner product, so it is positive semidefinite.
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
    ends = [series.exact_part[1:3] for series in found]
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
