"""Whether the rewards of one episode grow throughout it."""

from __future__ import annotations

from itertools import pairwise

_PARTS = 8
_GROWTH = 4.0
#: Most games pay rewards of this size.
_USUAL = 1.0


def growth(rewards: list[float]) -> float | None:
    """How many times larger rewards are in the last eighth of an episode than in the first eighth that pays.

    Args:
        rewards: all rewards of an episode, shape ``(steps,)``.

    Returns:
        The ratio; None if some eighth does not exceed the one before, if growth starts in the second half, or if the
        ratio or the last rewards are small.
    """
    sizes = _sizes(rewards)
    paid = sizes[next((number for number, size in enumerate(sizes) if size), _PARTS) :]
    if len(paid) < _PARTS // 2 or any(later <= earlier for earlier, later in pairwise(paid)):
        return None
    ratio = paid[-1] / paid[0]
    return ratio if ratio >= _GROWTH and paid[-1] >= _USUAL else None


def falls(rewards: list[float]) -> bool:
    """Whether the size of rewards falls from one eighth of an episode to the next."""
    return any(later < earlier for earlier, later in pairwise(_sizes(rewards)))


def _sizes(rewards: list[float]) -> list[float]:
    """The median size of rewards in each eighth of an episode: single large rewards do not count."""
    part = len(rewards) // _PARTS
    parts = (sorted(map(abs, rewards[number * part : (number + 1) * part])) for number in range(_PARTS))
    return [window[len(window) // 2] for window in parts]
