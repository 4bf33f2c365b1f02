"""Checkpoints of a run: the networks, the optimiser, the replay and the counters, in safetensors. Imports torch.

``state.json`` names the files of the checkpoint and is replaced last. A killed run therefore always leaves one complete
checkpoint. The replay is split into parts of some ten thousand slots; a checkpoint writes only the parts that changed.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import safetensors.numpy
import safetensors.torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, isfinite

from envcraft.errors import EnvCraftError, UsageError
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.files import write_atomically
from envcraft_dqn.network import Network, seeded_weights
from envcraft_dqn.replay import Replay
from envcraft_dqn.settings import Settings

#: The slots of the replay per file.
_PART = 1 << 14
_MANIFEST = "state.json"
#: The number of differences listed in a message.
_LISTED = 5
#: The errors from reading truncated, modified or foreign files.
_UNREADABLE = (
    OSError,
    ArithmeticError,
    AttributeError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
    msgspec.MsgspecError,
    SafetensorError,
)


class Checkpoint:
    """The checkpoint of a run.

    Args:
        folder: The folder of the checkpoint.
        settings, names: The settings and the environments of the run.
        every: The seconds between two checkpoints.
        sources: The identities of the environments, by name.
        demonstrations: The identity of the demonstrations.
        initial: The identity of the first weights.

    A run resumes only with equal settings, environments, sources, demonstrations and first weights, except that the
    steps may be more than before.
    """

    def __init__(
        self,
        folder: Path,
        settings: Settings,
        names: Sequence[str],
        every: float,
        sources: Mapping[str, str] | None = None,
        demonstrations: str = "none",
        initial: str = "random",
    ) -> None:
        self._folder, self._every = folder, every
        self._run = {
            "settings": msgspec.to_builtins(settings),
            "environments": list(names),
            "demonstrations": demonstrations,
            "sources": dict(sources or {}),
            "initial": initial,
        }
        self._serial = self._added = 0
        self._parts: dict[int, str] = {}
        self._saved = time.monotonic()

    @property
    def exists(self) -> bool:
        """Whether there is a checkpoint to resume from."""
        return (self._folder / _MANIFEST).is_file()

    @property
    def due(self) -> bool:
        """Whether it is time for the next checkpoint."""
        return time.monotonic() - self._saved >= self._every

    def save(self, numbers: dict[str, Any], tensors: dict[str, Tensor], replay: Replay) -> None:
        """Write a checkpoint with the counters `numbers`, which are plain data. Raises EnvCraftError."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._serial += 1
            learner, priorities = f"learner-{self._serial}.safetensors", f"priorities-{self._serial}.safetensors"
            whole = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
            write_atomically(self._folder / learner, safetensors.torch.save(whole), sync=True)
            counts, arrays = replay.state()
            write_atomically(self._folder / priorities, safetensors.numpy.save(_contiguous(arrays)), sync=True)
            for part in replay.written_since(self._added, _PART):
                first, end = part * _PART, min((part + 1) * _PART, len(replay))
                name = f"replay-{part}-{self._serial}.safetensors"
                data = safetensors.numpy.save(_contiguous(replay.dump(first, end)))
                write_atomically(self._folder / name, data, sync=True)
                self._parts[part] = name
            files = {"learner": learner, "priorities": priorities, "replay": list(self._parts.values())}
            state = {**self._run, "serial": self._serial, "numbers": numbers, "replay": counts, "files": files}
            write_atomically(self._folder / _MANIFEST, json.dumps(state), sync=True)
            self._added = replay.added
            self._sweep({learner, priorities, *self._parts.values()})
        except OSError as error:
            raise EnvCraftError(f"{self._folder} cannot be written: {error.strerror or error}") from None
        self._saved = time.monotonic()

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """A context for reading the checkpoint and restoring from it. Raises EnvCraftError for unreadable files."""
        try:
            yield
        except _UNREADABLE as error:
            raise EnvCraftError(
                f"the checkpoint {self._folder} cannot be read ({type(error).__name__}: {error}); remove it to start "
                "over"
            ) from None

    def load(self, replay: Replay) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """Restore `replay`, and return the counters and the tensors. Call it within :meth:`reading`.

        Raises:
            UsageError: The checkpoint belongs to another run.
        """
        state = json.loads((self._folder / _MANIFEST).read_text("utf-8"))
        for what, mine in self._run.items():
            if what in ("demonstrations", "sources", "initial") and what not in state:
                raise UsageError(
                    f"{self._folder} has a run of an earlier version of EnvCraft, which did not record its {what}; "
                    "choose another --output, or remove the folder to start over"
                )
            if what == "settings" and isinstance(state[what], dict) and (new := mine.keys() - state[what].keys()):
                raise UsageError(
                    f"{self._folder} has a run of an earlier version of EnvCraft, which had no setting "
                    f"{' and '.join(sorted(new))}; choose another --output, or remove the folder to start over"
                )
            if what == "settings" and isinstance(state[what], dict) and state[what].get("steps", 0) < mine["steps"]:
                state[what]["steps"] = mine["steps"]
            if state[what] != mine:
                raise UsageError(f"{self._folder} has a run with other {what}{_differing(state[what], mine)}")
        files = state["files"]
        tensors = safetensors.torch.load_file(self._folder / files["learner"])
        for name in files["replay"]:
            part = int(name.split("-")[1])
            replay.load(part * _PART, safetensors.numpy.load_file(self._folder / name))
            self._parts[part] = name
        replay.restore(state["replay"], safetensors.numpy.load_file(self._folder / files["priorities"]))
        self._serial, self._added = int(state["serial"]), replay.added
        self._sweep({files["learner"], files["priorities"], *self._parts.values()})
        return dict(state["numbers"]), tensors

    def _sweep(self, wanted: set[str]) -> None:
        """Remove files that belong to no checkpoint, such as those of an interrupted write."""
        for path in self._folder.glob("*.safetensors*"):
            if path.name not in wanted:
                path.unlink()


def _contiguous(arrays: dict[str, Any]) -> dict[str, Any]:
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def _differing(theirs: Any, mine: Any) -> str:
    """Describe the difference between two values of the manifest."""
    if isinstance(mine, list):
        return "; choose another --output"
    if isinstance(mine, str):
        return f" ({theirs}, not {mine}); choose another --output"
    keys = [key for key in {**theirs, **mine} if theirs.get(key) != mine.get(key)]
    listed = [f"{key} {theirs.get(key)}, not {mine.get(key)}" for key in keys[:_LISTED]]
    more = [f"and {len(keys) - _LISTED:,} more"] if len(keys) > _LISTED else []
    return f" ({', '.join(listed + more)}); choose another --output"


def save_agent(path: Path, network: Network, spec: EnvSpec, precision: str = "fp32") -> Path:
    """Write a network, its architecture and the precision of its training; return `path`. Raises EnvCraftError."""
    metadata = {"surface": msgspec.to_builtins(spec), "size": network.size, "head": network.head}
    metadata |= {"precision": precision, "temperature": network.temperature}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    try:
        write_atomically(path, safetensors.torch.save(tensors, {"envcraft": json.dumps(metadata, sort_keys=True)}))
    except OSError as error:
        raise EnvCraftError(f"{path} cannot be written: {error.strerror or error}") from None
    return path


def load_agent(path: Path) -> tuple[Network, EnvSpec]:
    """Read a network that :func:`save_agent` wrote, and the spec of its environments. Raises UsageError."""
    try:
        with safe_open(path, "pt") as file:
            metadata = json.loads((file.metadata() or {})["envcraft"])
            spec = msgspec.convert(metadata["surface"], EnvSpec)
            with seeded_weights(0):
                # Agents of earlier versions are greedy.
                temperature = float(metadata.get("temperature", 0.0))
                network = Network(spec.shape, spec.choices, metadata["size"], metadata["head"], temperature)
            names = file.keys()
            tensors = {name: file.get_tensor(name) for name in names}
            network.load_state_dict(tensors)
    except FileNotFoundError:
        raise UsageError(f"{path} does not exist; name what `envcraft train` wrote") from None
    except _UNREADABLE as error:
        raise UsageError(f"{path} is not an agent of `envcraft train`: {type(error).__name__}: {error}") from None
    if not all(isfinite(tensor).all() for tensor in tensors.values()):
        raise UsageError(f"{path} has weights that are not finite, which indicates a failed training")
    return network, spec
