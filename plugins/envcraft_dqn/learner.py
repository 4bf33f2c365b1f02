"""The learner: a duelling double DQN, which may imitate a demonstrator as well. Imports torch."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from envcraft.errors import UsageError
from envcraft_dqn.augmentation import augmented
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.frames import Frames
from envcraft_dqn.network import Network, keep_memory, seeded_weights
from envcraft_dqn.replay import Batch
from envcraft_dqn.settings import Settings

#: The slope of the linear part of rescaled values (Pohlen et al. 2018).
_SLOPE = 1e-2


class Learner:
    """The online network with its optimiser, and the target network."""

    def __init__(self, settings: Settings, spec: EnvSpec) -> None:
        self.settings, self._spec = settings, spec
        self.device = device_named(settings.device)
        if self.device.type == "cpu":
            keep_memory()
        with seeded_weights(settings.seed):
            parts = settings.size, settings.head, settings.temperature
            networks = [Network(spec.shape, spec.choices, *parts) for _ in range(2)]
        self.network, self.target = (network.on_device(self.device) for network in networks)
        self.target.load_state_dict(self.network.state_dict())
        self.target.requires_grad_(False)
        # The epsilon of Hessel et al. 2018 (arXiv:1710.02298).
        self.optimiser = torch.optim.Adam(self.network.parameters(), settings.learning_rate, eps=1.5e-4, fused=True)
        self.bf16 = settings.precision == "bf16" or (settings.precision == "auto" and _faster_in_bf16(self.device))
        self._generator = torch.Generator().manual_seed(settings.seed)
        self._loss = torch.compile(self._eager_loss) if settings.compiled else self._eager_loss

    @property
    def precision(self) -> str:
        """The precision of the convolutions and streams: bf16 or fp32."""
        return "bf16" if self.bf16 else "fp32"

    def start_from(self, network: Network, spec: EnvSpec) -> None:
        """Take over the weights of a network for environments with `spec`. Raises UsageError for another one."""
        own = self.network
        theirs, mine = ((one.size, one.head, one.choices) for one in (network, own))
        if theirs != mine or spec.shape != self._spec.shape:
            raise UsageError(
                f"the initial agent is a network {theirs[0]!r} with head {theirs[1]!r} for {spec}, and this run has a "
                f"network {mine[0]!r} with head {mine[1]!r} for {self._spec}"
            )
        own.load_state_dict(network.state_dict())
        self.synchronise()

    def act(self, frames: Frames) -> NDArray[np.int64]:
        """The greedy joint actions [n] for `frames` [n, *shape]."""
        return self.decide(frames)[0]

    def decide(
        self, frames: Frames, rng: np.random.Generator | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The joint actions [n] for `frames` [n, *shape], and the leads [n] of the highest values over the next ones.

        A small lead, compared with the noise of the values, means that the policy is arbitrary. The actions are those
        of an agent with the temperature of the settings if there is a random generator, and greedy otherwise.
        """
        with torch.no_grad(), self._autocast():
            pixels = self.network.preprocess(self._on_device(frames))
            values = self.network.advantages(pixels)
            best, actions = values.topk(2)
            chosen = actions[:, 0].cpu().numpy() if rng is None else self.network.choose(values, rng)
        return chosen, (best[:, 0] - best[:, 1]).cpu().numpy()

    def update(self, batch: Batch) -> tuple[NDArray[np.float32], float]:
        """Make one step of the optimiser; return the errors [n] of the batch, for its priorities, and its loss.

        The errors are TD errors, or the cross-entropies of an objective that only imitates.
        """
        frames, next_frames = self._on_device(batch.frames), self._on_device(batch.next_frames)
        if (kind := self.settings.augment) != "none":
            frames, next_frames = (augmented(some, kind, self._generator) for some in (frames, next_frames))
        label_weights = batch.label_weights if self.settings.balanced else (batch.labels >= 0).astype(np.float32)
        arrays = (
            batch.actions,
            batch.returns,
            batch.discounts,
            batch.weights,
            batch.labels,
            label_weights,
            batch.advice,
        )
        loss, errors = self._loss(frames, next_frames, *(self._on_device(array) for array in arrays))
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return errors.cpu().numpy(), float(loss.detach())

    def anneal(self, done: float) -> None:
        """Set the learning rate for this share of all updates."""
        if self.settings.decay:
            for group in self.optimiser.param_groups:
                group["lr"] = self.settings.learning_rate * max(1.0 - done, 0.0)

    def synchronise(self) -> None:
        """Copy the online network to the target network."""
        self.target.load_state_dict(self.network.state_dict())

    def _eager_loss(
        self,
        frames: Tensor,
        next_frames: Tensor,
        actions: Tensor,
        returns: Tensor,
        discounts: Tensor,
        weights: Tensor,
        labels: Tensor,
        label_weights: Tensor,
        advice: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """The loss of the objective, and the errors [n] for priorities."""
        with self._autocast():
            values = self.network(frames)
        if self.settings.objective == "dqn":
            loss, errors = self._td_loss(values, next_frames, actions, returns, discounts)
            return (weights * loss).mean(), errors
        known = labels.clamp(min=0)
        if self.settings.imitates:
            # Unlike a margin, the likelihood has its optimum at the most frequent label where labels are noisy.
            imitation = functional.cross_entropy(values, known, reduction="none")
            if advice.shape[1]:
                advised = advice.sum(1) > 0
                imitation = torch.where(advised, functional.cross_entropy(values, advice, reduction="none"), imitation)
                label_weights = torch.where(advised, torch.ones_like(label_weights), label_weights)
            return (weights * label_weights * imitation).mean(), imitation.detach() * (labels >= 0)
        imitation = large_margin(values, known, self.settings.margin)
        loss, errors = self._td_loss(values, next_frames, actions, returns, discounts)
        return (weights * (loss + label_weights * imitation)).mean(), errors

    def _td_loss(
        self, values: Tensor, next_frames: Tensor, actions: Tensor, returns: Tensor, discounts: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The Huber losses [n] of double Q-learning (van Hasselt et al. 2016, arXiv:1509.06461), and TD errors [n]."""
        with torch.no_grad(), self._autocast():
            pixels = self.network.preprocess(next_frames)
            best = self.network.greedy(pixels)
            following = self.target.values(pixels).gather(1, best[:, None]).squeeze(1)
        chosen = values.gather(1, actions[:, None]).squeeze(1)
        if self.settings.value_rescaling:
            targets = rescale(returns + discounts * unrescale(following))
        else:
            targets = returns + discounts * following
        return functional.smooth_l1_loss(chosen, targets, reduction="none"), targets - chosen.detach()

    def _autocast(self) -> contextlib.AbstractContextManager[Any]:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16)

    def _on_device(self, array: Any) -> Tensor:
        tensor = array if isinstance(array, Tensor) else torch.from_numpy(array)
        return tensor.to(self.device, non_blocking=True)

    def state(self) -> dict[str, Tensor]:
        """All tensors that an update changes, by name."""
        tensors = {"augmentation.state": self._generator.get_state()}
        tensors |= {f"network.{name}": value for name, value in self.network.state_dict().items()}
        tensors |= {f"target.{name}": value for name, value in self.target.state_dict().items()}
        for number, state in self.optimiser.state_dict()["state"].items():
            tensors |= {f"adam.{number}.{name}": value for name, value in state.items()}
        return tensors

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` returned. Raises UsageError if it belongs to another architecture."""
        parts: dict[str, dict[str, Tensor]] = {"network": {}, "target": {}, "adam": {}, "augmentation": {}}
        for name, value in tensors.items():
            part, _, rest = name.partition(".")
            parts[part][rest] = value
        try:
            self.network.load_state_dict(parts["network"])
            self.target.load_state_dict(parts["target"])
        except RuntimeError:
            raise UsageError(
                f"the checkpoint has a network {self.settings.size!r} with other layers, from another version of "
                "EnvCraft; train in another folder"
            ) from None
        self._generator.set_state(parts["augmentation"]["state"])
        state: dict[int, dict[str, Tensor]] = {}
        for name, value in parts["adam"].items():
            number, _, field = name.partition(".")
            state.setdefault(int(number), {})[field] = value
        whole = self.optimiser.state_dict()
        self.optimiser.load_state_dict({**whole, "state": state})
        for parameter, values in self.optimiser.state.items():
            # The memory layout of the parameter decides the order of floating-point sums.
            for field in ("exp_avg", "exp_avg_sq"):
                values[field] = torch.empty_like(parameter).copy_(values[field])


def large_margin(values: Tensor, labels: Tensor, margin: float) -> Tensor:
    """The large-margin losses [n] of values [n, actions] (Hester et al. 2018, arXiv:1704.03732): the amount by which
    the best other action, plus `margin`, exceeds the labelled action [n].
    """
    margins = torch.full_like(values, margin).scatter_(1, labels[:, None], 0.0)
    return (values + margins).amax(1) - values.gather(1, labels[:, None]).squeeze(1)


def rescale(values: Tensor) -> Tensor:
    """Compress large values: ``sign(x) (sqrt(|x| + 1) - 1) + 0.01 x`` (Pohlen et al. 2018, arXiv:1805.11593)."""
    return values.sign() * ((values.abs() + 1).sqrt() - 1) + _SLOPE * values


def unrescale(values: Tensor) -> Tensor:
    """The inverse of :func:`rescale`."""
    root = ((1 + 4 * _SLOPE * (values.abs() + 1 + _SLOPE)).sqrt() - 1) / (2 * _SLOPE)
    return values.sign() * (root**2 - 1)


def device_named(name: str) -> torch.device:
    """A torch device by name; ``auto`` is the GPU if there is one. Raises UsageError."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise UsageError(f"--device {name} is not a device of torch; name one such as cpu, cuda or cuda:1") from None
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, ImportError) as error:
        # For a device without a driver torch says in many words that it has no operator.
        reason = "" if isinstance(error, NotImplementedError | ImportError) else f": {str(error).splitlines()[0]}"
        raise UsageError(f"--device {name} is not available on this machine{reason}") from None
    return device


def _faster_in_bf16(device: torch.device) -> bool:
    """Whether bfloat16 is faster: on devices with instructions for it. Others emulate it, or do not have it."""
    if device.type == "cuda":
        # Compute capability 8.0 (Ampere) brought these instructions.
        return torch.cuda.get_device_capability(device)[0] >= 8
    if device.type != "cpu":
        return False
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
