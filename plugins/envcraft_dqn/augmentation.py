"""Random changes to frames (Laskin et al. 2020, arXiv:2004.14990). Imports torch.

An agent that sees many looks of the same state generalises to looks that it has not seen.
"""

from __future__ import annotations

import torch
from torch import Tensor

#: The largest shift in pixels along each axis.
_SHIFT = 4
#: The range of the factors of colour channels.
_DARKEST, _BRIGHTEST = 0.6, 1.4
#: The standard deviation of the weights of a mixed channel, and the step between the pixels that give the mean colour.
_CONTRAST, _SAMPLED = 0.7, 17


def augmented(frames: Tensor, kind: str, generator: torch.Generator) -> Tensor:
    """Change each frame at random.

    Args:
        frames: Frames of bytes, [n, height, width, channels].
        kind: ``shift``, ``colour``, ``both`` or ``mixed``.
        generator: The random generator, on the CPU.

    Returns:
        Frames of bytes of the same shape.
    """
    if kind in ("shift", "both"):
        frames = _shifted(frames, generator)
    if kind in ("colour", "both"):
        frames = _recoloured(frames, generator)
    if kind == "mixed":
        frames = _mixed(frames, generator)
    return frames


def _shifted(frames: Tensor, generator: torch.Generator) -> Tensor:
    """Shift each frame by up to four pixels along each axis. Pixels at the edges are repeated."""
    count, height, width, _ = frames.shape
    by = torch.randint(-_SHIFT, _SHIFT + 1, (2, count, 1), generator=generator).to(frames.device)
    rows = (torch.arange(height, device=frames.device) + by[0]).clamp(0, height - 1)
    columns = (torch.arange(width, device=frames.device) + by[1]).clamp(0, width - 1)
    places = torch.arange(count, device=frames.device)[:, None, None]
    return frames[places, rows[:, :, None], columns[:, None, :]]


def _recoloured(frames: Tensor, generator: torch.Generator) -> Tensor:
    """Permute the colour channels of each frame, and make each channel darker or brighter."""
    count, _, _, channels = frames.shape
    order = torch.rand((count, channels), generator=generator).argsort(1).to(frames.device)
    factors = torch.empty((count, 1, 1, channels)).uniform_(_DARKEST, _BRIGHTEST, generator=generator)
    permuted = frames.gather(3, order[:, None, None, :].expand(frames.shape))
    return (permuted * factors.to(frames.device)).clamp_(0, 255).to(torch.uint8)


def _mixed(frames: Tensor, generator: torch.Generator) -> Tensor:
    """Replace the colour channels of each frame by random linear combinations of them, which keeps shapes alone.

    Networks that standardise frames remove the offset and the scale that the combinations cause.
    """
    count, _, _, channels = frames.shape
    weights = torch.randn((count, channels, channels), generator=generator).mul_(_CONTRAST / channels**0.5)
    pixels = frames.flatten(1, 2).float()
    pixels -= pixels[:, ::_SAMPLED].mean(1, keepdim=True)
    return torch.bmm(pixels, weights.to(frames.device)).add_(127.5).clamp_(0, 255).to(torch.uint8).view_as(frames)
