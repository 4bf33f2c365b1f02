"""The network: convolutions and a duelling head. Imports torch."""

from __future__ import annotations

import contextlib
import ctypes
import math
import threading
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from envcraft_dqn.settings import SIZES

#: Parameters of mallopt(3): the number of allocations by mmap, and the amount of freed memory to keep.
_MMAP_MAX, _TRIM_THRESHOLD = -4, -1

#: The step between the pixels that standardise a frame, and what is added to their spread for frames of one colour.
_SAMPLED, _FLAT = 4, 5.0

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
    """Initialise networks within this context from `seed`. The global generators of torch stay unchanged, and
    threads wait for each other.
    """
    with _SEEDING, torch.random.fork_rng(devices=[]):
        # torch.manual_seed would also seed the generators of the GPUs, and weights are initialised on the CPU.
        torch.default_generator.manual_seed(seed)
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
        temperature: The temperature of :meth:`choose`.
    """

    def __init__(
        self,
        shape: Sequence[int],
        choices: Sequence[int],
        size: str = "small",
        head: str = "joint",
        temperature: float = 0.0,
    ) -> None:
        super().__init__()
        self.choices, self.size, self.head, self.temperature = tuple(choices), size, head, temperature
        layers = SIZES[size]
        width = layers.width
        self.convolutions = nn.ModuleList()
        height, breadth, depth = shape
        for channel, kernel, stride in zip(layers.channels, layers.kernels, layers.strides, strict=True):
            # A map has the size of the last one by the stride, rounded up.
            padding = (kernel - 1) // 2
            self.convolutions.append(nn.Conv2d(depth, channel, kernel, stride, padding))
            height, breadth, depth = -(-height // stride), -(-breadth // stride), channel
        # One matrix product computes the first layers of both streams.
        self.streams = nn.Linear(height * breadth * depth, 2 * width)
        self.value = nn.Linear(width, 1)
        self.advantage = nn.Linear(width, sum(choices) if head == "branching" else math.prod(choices))
        self._standardised = layers.standardised
        if self._standardised:
            self._initialise()

    def forward(self, frames: Tensor) -> Tensor:
        return self.values(self.preprocess(frames))

    def preprocess(self, frames: Tensor) -> Tensor:
        """Convert frames to inputs of the convolutions, [n, channels, height, width].

        Pixels are in [0, 1]. For a standardised network, each channel of a frame has mean 0, and their standard
        deviations have mean 1, so that the theme of a frame affects its inputs less.
        """
        # The frames are in channels_last order already, so this copies nothing.
        pixels = frames.permute(0, 3, 1, 2).to(self.value.weight.dtype)
        if not self._standardised:
            return pixels.div_(255)
        # One pixel in sixteen gives nearly the same statistics in much less time.
        some = pixels[:, :, ::_SAMPLED, ::_SAMPLED]
        spread = some.std((2, 3), unbiased=False).mean(1)[:, None, None, None]
        return pixels.sub_(some.mean((2, 3), keepdim=True)).div_(spread + _FLAT)

    def _initialise(self) -> None:
        """Keep the scale of the inputs through the layers (He et al. 2015), with small outputs."""
        for layer in (*self.convolutions, self.streams):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            nn.init.zeros_(layer.bias)
        for output in (self.value, self.advantage):
            nn.init.normal_(output.weight, std=0.1 / math.sqrt(output.in_features))
            nn.init.zeros_(output.bias)

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

    def choose(self, advantages: Tensor, rng: np.random.Generator) -> NDArray[np.int64]:
        """The joint actions [n] for values [n, actions]: the best, or drawn from the softmax at the temperature."""
        if self.temperature:
            # The highest of values with Gumbel noise has the distribution of the softmax.
            noise = rng.gumbel(scale=self.temperature, size=tuple(advantages.shape))
            advantages = advantages + torch.from_numpy(noise).to(advantages)
        actions: NDArray[np.int64] = advantages.argmax(1).cpu().numpy()
        return actions

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
