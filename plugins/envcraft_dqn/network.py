"""The network: five convolutions and a duelling head. Imports torch."""

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
#: Parameters of mallopt(3): the number of allocations by mmap, and the amount of freed memory to keep.
_MMAP_MAX, _TRIM_THRESHOLD = -4, -1

_SEEDING = threading.Lock()


def keep_memory() -> None:
    """Make the C library keep freed memory, if it can.

    Otherwise each update of a large network causes tens of thousands of page faults, because gradients and frames are
    allocated from the system each time.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_MAX, 0)
        mallopt(_TRIM_THRESHOLD, 2**31 - 1)


@contextlib.contextmanager
def seeded_weights(seed: int) -> Iterator[None]:
    """Initialise networks within this context from `seed`. The global generator of torch stays unchanged, and
    threads wait for each other.
    """
    with _SEEDING, torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Limit torch to one thread, because other subjects need the other cores, and a verdict must not depend on the
    machine. On a busy machine, one thread is also many times faster for single frames.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _full_precision(tensor: Tensor) -> contextlib.AbstractContextManager[Any]:
    """A context without autocast."""
    return torch.autocast(tensor.device.type, enabled=False)


class Network(nn.Module):
    """Maps frames [n, height, width, channels] of bytes to the values of all joint actions [n, actions].

    The head has a stream for the state value and one for the advantages (Wang et al. 2016, arXiv:1511.06581). With the
    head ``branching``, the advantage of an action is the sum over its components (Seyde et al. 2023, arXiv:2210.12566),
    so that MultiDiscrete([5, 2, 2]) needs 9 outputs instead of 20. The outputs and their sum are 32-bit floats under
    any autocast: bfloat16 has 8 bits of precision, too few for the small differences between the values of actions.

    Args:
        shape: The shape of a frame, [height, width, channels].
        choices: The number of values of each component of an action.
        size: A key of :data:`envcraft_dqn.settings.SIZES`.
        head: ``joint`` or ``branching``.
    """

    def __init__(self, shape: Sequence[int], choices: Sequence[int], size: str = "small", head: str = "joint") -> None:
        super().__init__()
        self.choices, self.size, self.head = tuple(choices), size, head
        channels, width = SIZES[size]
        self.convolutions = nn.ModuleList()
        height, breadth, depth = shape
        for channel, stride in zip(channels, _STRIDES, strict=True):
            self.convolutions.append(nn.Conv2d(depth, channel, 3, stride, 1))
            height, breadth, depth = -(-height // stride), -(-breadth // stride), channel
        # One matrix product computes the first layers of both streams.
        self.streams = nn.Linear(height * breadth * depth, 2 * width)
        self.value = nn.Linear(width, 1)
        self.advantage = nn.Linear(width, sum(choices) if head == "branching" else math.prod(choices))

    def forward(self, frames: Tensor) -> Tensor:
        return self.values(self.preprocess(frames))

    def preprocess(self, frames: Tensor) -> Tensor:
        """Convert frames to inputs of the convolutions, [n, channels, height, width] in [0, 1]."""
        # The frames are in channels_last order already, so this copies nothing.
        return frames.permute(0, 3, 1, 2).to(self.value.weight.dtype).div_(255)

    def values(self, pixels: Tensor) -> Tensor:
        """The values of all joint actions, [n, actions], from the result of :meth:`preprocess`."""
        hidden = self.streams(self._features(pixels)).relu_()
        with _full_precision(hidden):
            value, advantage = hidden.float().chunk(2, 1)
            advantages = self._joint(self.advantage(advantage))
            result: Tensor = self.value(value) + advantages - advantages.mean(1, keepdim=True)
        return result

    def greedy(self, pixels: Tensor) -> Tensor:
        """The joint actions with the highest values, [n]."""
        return self.advantages(pixels).argmax(1)

    def advantages(self, pixels: Tensor) -> Tensor:
        """The values of all joint actions up to a constant, [n, actions]. It skips the stream of the state value."""
        width = self.value.in_features
        weight, bias = self.streams.weight[width:], self.streams.bias[width:]
        hidden = functional.linear(self._features(pixels), weight, bias).relu_()
        with _full_precision(hidden):
            return self._joint(self.advantage(hidden.float()))

    def _features(self, pixels: Tensor) -> Tensor:
        """The features of the convolutions, [n, features]. Calls of functions instead of modules save 3% of an update
        of ``small`` on a CPU.
        """
        layer: Any
        for layer in self.convolutions:
            pixels = functional.conv2d(pixels, layer.weight, layer.bias, layer.stride, layer.padding).relu_()
        return pixels.flatten(1)

    def _joint(self, parts: Tensor) -> Tensor:
        """Sum the components for every joint action, the last component varying fastest: [n, sum] to [n, product]."""
        if self.head == "joint":
            return parts
        joint = parts.new_zeros((len(parts), 1))
        for part in torch.split(parts, list(self.choices), 1):
            joint = (joint[:, :, None] + part[:, None, :]).flatten(1)
        return joint

    def on_device(self, device: torch.device) -> Network:
        """Move the network to a device, with filters in channels_last order."""
        whole: Any = self.to(device)
        result: Network = whole.to(memory_format=torch.channels_last)
        return result

    @property
    def parameter_count(self) -> int:
        """The number of parameters."""
        return sum(parameter.numel() for parameter in self.parameters())
