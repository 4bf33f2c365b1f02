"""Scale pictures to a screen, and draw them with the half-block characters of a terminal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]


def fit(picture: Picture, width: int, height: int) -> Picture:
    """Scale RGB pixels to fit into `width` and `height` pixels.

    To enlarge, each pixel is repeated an integer number of times. To shrink, each pixel is the mean of its area.

    Args:
        picture: pixels of shape (H, W, 3).
        width: the maximum width in pixels.
        height: the maximum height in pixels.
    """
    tall, wide = picture.shape[:2]
    scale = min(width / wide, height / tall)
    if scale >= 1:
        larger: Picture = picture.repeat(int(scale), axis=0).repeat(int(scale), axis=1)
        return larger
    rows, columns = (_weigh(length, max(round(length * scale), 1)) for length in (tall, wide))
    mean = np.einsum("hw,wvc,xv->hxc", rows, picture.astype(np.float32), columns, optimize=True)
    smaller: Picture = np.clip(np.rint(mean), 0, 255).astype(np.uint8)
    return smaller


def half_blocks(picture: Picture) -> list[str]:
    """Return one line for two rows of pixels: upper half blocks in the upper colours on the lower colours."""
    if len(picture) % 2:
        picture = np.vstack([picture, np.zeros_like(picture[:1])])
    lines = []
    for upper, lower in zip(picture[::2].tolist(), picture[1::2].tolist(), strict=True):
        line, last = [], None
        for colours in zip(upper, lower, strict=True):
            if colours != last:
                (red, green, blue), (red_below, green_below, blue_below) = last = colours
                line.append(f"\x1b[38;2;{red};{green};{blue};48;2;{red_below};{green_below};{blue_below}m")
            line.append("▀")
        lines.append("".join(line) + "\x1b[0m")
    return lines


def _weigh(source: int, target: int) -> NDArray[np.float32]:
    """A `(target, source)` matrix of overlaps, each row with sum 1."""
    edges = np.arange(target + 1) * source / target
    pixels = np.arange(source)
    overlap = np.minimum(edges[1:, None], pixels + 1) - np.maximum(edges[:-1, None], pixels)
    weights: NDArray[np.float32] = (np.clip(overlap, 0, 1) * target / source).astype(np.float32)
    return weights
