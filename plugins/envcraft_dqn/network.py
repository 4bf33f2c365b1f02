"""The network: five convolutions over a frame, and the two streams of a duelling head. Imports torch."""

from __future__ import annotations

import contextlib
import ctypes
import math
import threading
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from envcraft_dqn.settings import SIZES

_STRIDES = (2, 2, 2, 2, 1)
#: Of mallopt(3): how many pieces of memory are fetched from the system singly, and how much stays when it is free.
_MMAP_MAX, _TRIM_THRESHOLD = -4, -1

_MAKING = threading.Lock()


def keep_memory() -> None:
    """Have this process keep memory that is freed, where its C library can. Else each update of a large network begins
    with tens of thousands of page faults, since gradients and frames are fetched from the system anew.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_MAX, 0)
        mallopt(_TRIM_THRESHOLD, 2**31 - 1)


@contextlib.contextmanager
def weights_from(seed: int) -> Iterator[None]:
    """Networks that are made in this block have the weights of `seed`. The global generator, which whoever uses this
    library has for themselves, is as before; threads wait for one another.
    """
    with _MAKING, torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


class Network(nn.Module):
    """Values of all joint actions, [n, actions], from frames [n, height, width, 3] of bytes.

    The streams of state value and of advantages are those of Wang et al. 2016 (arXiv:1511.06581). With the head
    ``branching`` an action's advantage is the sum of those of its parts (Seyde et al. 2023, arXiv:2210.12566), so that
    MultiDiscrete([5, 2, 2]) takes 9 outputs in place of 20.
    """

    def __init__(self, shape: Sequence[int], choices: Sequence[int], size: str = "small", head: str = "joint") -> None:
        """`shape` of a frame, and how many `choices` each part of an action has."""
        super().__init__()
        self.choices, self.size, self.head = tuple(choices), size, head
        channels, width = SIZES[size]
        self.convolutions = nn.ModuleList()
        height, breadth, depth = shape
        for channel, stride in zip(channels, _STRIDES, strict=True):
            self.convolutions.append(nn.Conv2d(depth, channel, 3, stride, 1))
            height, breadth, depth = -(-height // stride), -(-breadth // stride), channel
        # Both streams' first layers as one: a larger product of matrices in place of two.
        self.streams = nn.Linear(height * breadth * depth, 2 * width)
        self.value = nn.Linear(width, 1)
        self.advantage = nn.Linear(width, sum(choices) if head == "branching" else math.prod(choices))

    def forward(self, frames: Tensor) -> Tensor:
        return self.values(self.pixels(frames))

    def pixels(self, frames: Tensor) -> Tensor:
        """Frames as the convolutions take them, [n, 3, height, width] from 0 to 1; the same for all networks."""
        # Height, width, channel in memory is torch's channels_last: no byte is moved.
        return frames.permute(0, 3, 1, 2).to(self.value.weight.dtype).div_(255)

    def values(self, pixels: Tensor) -> Tensor:
        """Values of all joint actions from what :meth:`pixels` gives."""
        value, advantage = self.streams(self._features(pixels)).relu_().chunk(2, 1)
        advantages = self._joint(self.advantage(advantage))
        found: Tensor = self.value(value) + advantages - advantages.mean(1, keepdim=True)
        return found

    def best(self, pixels: Tensor) -> Tensor:
        """The joint actions of the highest value, [n]. A state's value is the same for all of them: its stream is left
        out.
        """
        width = self.value.in_features
        weight, bias = self.streams.weight[width:], self.streams.bias[width:]
        return self._joint(self.advantage(functional.linear(self._features(pixels), weight, bias).relu_())).argmax(1)

    def _features(self, pixels: Tensor) -> Tensor:
        """What the convolutions give, [n, features]. They are called as functions: the calls of modules took 3% of an
        update of ``small`` on a processor.
        """
        layer: Any
        for layer in self.convolutions:
            pixels = functional.conv2d(pixels, layer.weight, layer.bias, layer.stride, layer.padding).relu_()
        return pixels.flatten(1)

    def _joint(self, parts: Tensor) -> Tensor:
        """Sums of one number of each part, the last part's changing quickest: [n, sum] to [n, product]."""
        if self.head == "joint":
            return parts
        joint = parts.new_zeros((len(parts), 1))
        for part in torch.split(parts, list(self.choices), 1):
            joint = (joint[:, :, None] + part[:, None, :]).flatten(1)
        return joint

    def placed(self, device: torch.device) -> Network:
        """On a device, with filters in memory as frames are: all channels of a place side by side."""
        whole: Any = self.to(device)
        found: Network = whole.to(memory_format=torch.channels_last)
        return found

    @property
    def parameter_count(self) -> int:
        return sum(parameter.numel() for parameter in self.parameters())
