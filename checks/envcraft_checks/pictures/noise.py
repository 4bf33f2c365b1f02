"""Pictures whose pixels are random at each step, and a test that distinguishes them from moving pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from envcraft.model.rollout import Rollout

from .traces import Defect, changed, shows_pictures

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_WATCHED = 64
#: The match of the best shift: 0.05 for independent noise and up to 0.35 if it has large blocks, 0.65 for a picture
#: that scrolls by a quarter of its width, and 1 for one that wraps around.
_MATCHES = 0.5


def find_noise(subject: Subject) -> Defect | None:
    """Find pictures that are independent noise while the first action is held, and while the last one is."""
    if not shows_pictures(subject.observation_space) or not all(_always_changes(trace) for trace in subject.held()):
        return None
    watched = []
    for action in (subject.joint_actions[0], subject.joint_actions[-1]):
        rollout = _watch(subject, action)
        trace = subject.rollout(rollout)
        measured = noise(trace.frames)
        if measured is None or not measured[0]:
            return None
        watched.append((rollout, measured))
    rollout, (_, changing, correlation) = watched[0]
    return Defect(
        f"{changing:.0%} of the picture changes at each step, independently of the steps before "
        f"(correlation at most {correlation:.2f})",
        rollout,
        {"changing": changing, "correlation": correlation},
    )


def _watch(subject: Subject, action: Any) -> Rollout:
    return Rollout(subject.episode_seed(0), [action] * _WATCHED, player=f"holding {action}", keep=_WATCHED)


def noise(frames: Sequence[Any]) -> tuple[bool, float, float] | None:
    """Whether frames are independent in time.

    Args:
        frames: consecutive frames, at least 12 arrays of one shape.

    Returns:
        The verdict, the share of values that change from frame to frame, and the highest correlation of a pixel with
        itself one to four frames later; None if the frames are too few or differ in shape.
    """
    import numpy as np

    if len(frames) < 12 or len({frame.shape for frame in frames}) != 1:
        return None
    stack = np.stack(frames[1:]).reshape(len(frames) - 1, -1).astype(np.float32)
    changing = float(np.mean(stack[1:] != stack[:-1]))
    rest = stack - stack.mean(axis=0)
    power = float(np.mean(rest**2))
    if power == 0:
        return False, changing, 1.0
    highest = max(abs(float(np.mean(rest[lag:] * rest[:-lag]))) / power for lag in range(1, 5))
    return changing > 0.5 and highest < 0.15 and not _moves(frames[1:]), changing, highest


def _moves(frames: Sequence[Any]) -> bool:
    """Whether most pictures are a shifted copy of the one before.

    The method is phase correlation (Kuglin and Hines, "The phase correlation image alignment method", 1975). For
    independent noise no shift stands out; a shift by zero does not count.
    """
    import numpy as np

    grey = np.stack(frames).astype(np.float32)
    grey = grey.mean(axis=3) if grey.ndim == 4 else grey
    if grey.ndim != 3:
        return False
    spectra = np.fft.rfft2(grey - grey.mean(axis=(1, 2), keepdims=True))
    cross = spectra[1:] * spectra[:-1].conj()
    matches = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-9), s=grey.shape[1:])
    matches[:, 0, 0] = 0
    return bool(np.median(matches.max(axis=(1, 2))) > _MATCHES)


def _always_changes(trace: Trace) -> bool:
    """Whether every step changes the observation, as noise does."""
    return all(changed(trace, step) for step in range(1, len(trace.observations)))
