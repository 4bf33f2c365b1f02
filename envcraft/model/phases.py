"""The calls of a job, as messages name them."""

from __future__ import annotations

_WORDS = {
    "construct": "the constructor",
    "spaces": "reading the spaces",
    "reset": "reset()",
    "plain reset": "reset(seed=None, options=None)",
    "step": "step()",
    "render": "render()",
    "close": "close()",
    "early close": "close() before reset()",
    "earlier reset": "reset() of an earlier episode",
    "before": "an earlier episode",
    "companion": "the episode of another instance",
    "search": "a search",
    "after": "an episode after the end",
}


def in_words(phase: str, step: int = 0) -> str:
    """Name a phase, and its step if it is ``step``.

    Args:
        phase: of a fault or of the end of a job.
        step: the number of the step; 0 if it is not known.

    Returns:
        For example ``the constructor``, ``reset()`` or ``step 12``.
    """
    return f"step {step}" if phase == "step" and step else _WORDS.get(phase, phase)
