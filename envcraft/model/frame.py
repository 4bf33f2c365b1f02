"""Pictures of an episode, for reports that show findings."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from envcraft.model.verdict import Finding, SubjectReport


class Frame(NamedTuple):
    """The frame after `step` steps (0 is the reset) as a PNG file.

    `expected` is the frame without the conditions of the finding, if they make it another one.
    """

    step: int
    png: bytes
    expected: bytes = b""


#: Renders the frames of a finding's reproduction up to the step of the finding; empty if the episode has no pictures.
FrameSource = Callable[[SubjectReport, Finding], list[Frame]]
