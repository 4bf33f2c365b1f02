"""A run as it was at one moment, in safetensors: what is learnt, the replay, and how far it has come. Imports torch.

``state.json`` names the files that belong together, and is replaced as the last of them, so whenever a run is killed
there is one whole checkpoint. The replay is in parts of some ten thousand slots; only those written since the last
checkpoint are written again.
"""

from __future__ import annotations

import contextlib
import json
import os
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
from envcraft_dqn.network import Network, weights_from
from envcraft_dqn.replay import Replay
from envcraft_dqn.settings import Settings
from envcraft_dqn.spaces import Surface

#: Slots of the replay in a file.
_PART = 1 << 14
_MANIFEST = "state.json"
#: Differences that are told one by one.
_TOLD = 5
#: What comes of reading files that were cut off, changed or written by something else.
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
    """The checkpoint in `folder` of a run of these settings on the environments `names`, saved each `every` seconds.

    `sources` tells what these environments are, and `demonstrations` whose they are: it goes on with no others.
    """

    def __init__(
        self,
        folder: Path,
        settings: Settings,
        names: Sequence[str],
        every: float,
        sources: Mapping[str, str] | None = None,
        demonstrations: str = "none",
    ) -> None:
        self._folder, self._every = folder, every
        self._run = {
            "settings": msgspec.to_builtins(settings),
            "environments": list(names),
            "demonstrations": demonstrations,
            "sources": dict(sources or {}),
        }
        self._serial = self._added = 0
        self._parts: dict[int, str] = {}
        self._saved = time.monotonic()

    @property
    def there(self) -> bool:
        return (self._folder / _MANIFEST).is_file()

    @property
    def due(self) -> bool:
        return time.monotonic() - self._saved >= self._every

    def save(self, numbers: dict[str, Any], tensors: dict[str, Tensor], replay: Replay) -> None:
        """Write it; `numbers` is plain data. Raises EnvCraftError where it cannot be written."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._serial += 1
            learner, priorities = f"learner-{self._serial}.safetensors", f"priorities-{self._serial}.safetensors"
            whole = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
            self._write(learner, safetensors.torch.save(whole))
            counts, arrays = replay.state()
            self._write(priorities, safetensors.numpy.save(_contiguous(arrays)))
            for part in replay.written_since(self._added, _PART):
                first, end = part * _PART, min((part + 1) * _PART, len(replay))
                name = f"replay-{part}-{self._serial}.safetensors"
                self._write(name, safetensors.numpy.save(_contiguous(replay.dump(first, end))))
                self._parts[part] = name
            files = {"learner": learner, "priorities": priorities, "replay": list(self._parts.values())}
            told = {**self._run, "serial": self._serial, "numbers": numbers, "replay": counts, "files": files}
            self._write(f"{_MANIFEST}.new", json.dumps(told).encode())
            os.replace(self._folder / f"{_MANIFEST}.new", self._folder / _MANIFEST)
            self._added = replay.added
            self._sweep({learner, priorities, *self._parts.values()})
        except OSError as error:
            raise EnvCraftError(f"{self._folder} cannot be written: {error.strerror or error}") from None
        self._saved = time.monotonic()

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """While it is read and put to use. Raises EnvCraftError where that cannot be."""
        try:
            yield
        except _UNREADABLE as error:
            raise EnvCraftError(
                f"the checkpoint {self._folder} cannot be read ({type(error).__name__}: {error}); remove it to begin "
                "anew"
            ) from None

    def load(self, replay: Replay) -> tuple[dict[str, Any], dict[str, Tensor]]:
        """Fill `replay`, within :meth:`reading`; give the numbers and tensors. Raises UsageError where it is another
        run's.
        """
        told = json.loads((self._folder / _MANIFEST).read_text("utf-8"))
        for what, mine in self._run.items():
            if what in ("demonstrations", "sources") and what not in told:
                raise UsageError(
                    f"{self._folder} has a run that an earlier version of EnvCraft began, which did not note its "
                    f"{what}; choose another --output, or remove it to begin anew"
                )
            if told[what] != mine:
                raise UsageError(f"{self._folder} has a run of other {what}{_differing(told[what], mine)}")
        files = told["files"]
        tensors = safetensors.torch.load_file(self._folder / files["learner"])
        for name in files["replay"]:
            part = int(name.split("-")[1])
            replay.load(part * _PART, safetensors.numpy.load_file(self._folder / name))
            self._parts[part] = name
        replay.restore(told["replay"], safetensors.numpy.load_file(self._folder / files["priorities"]))
        self._serial, self._added = int(told["serial"]), replay.added
        self._sweep({files["learner"], files["priorities"], *self._parts.values()})
        return dict(told["numbers"]), tensors

    def _write(self, name: str, data: bytes) -> None:
        with open(self._folder / name, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())

    def _sweep(self, wanted: set[str]) -> None:
        """Remove what belongs to no checkpoint, such as what was being written when a run was killed."""
        for path in self._folder.glob("*.safetensors"):
            if path.name not in wanted:
                path.unlink()


def _contiguous(arrays: dict[str, Any]) -> dict[str, Any]:
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def _differing(theirs: Any, mine: Any) -> str:
    """What differs, in words."""
    if isinstance(mine, list):
        return "; choose another --output"
    if isinstance(mine, str):
        return f" ({theirs}, not {mine}); choose another --output"
    keys = [key for key in {**theirs, **mine} if theirs.get(key) != mine.get(key)]
    told = [f"{key} {theirs.get(key)}, not {mine.get(key)}" for key in keys[:_TOLD]]
    more = [f"and {len(keys) - _TOLD:,} more"] if len(keys) > _TOLD else []
    return f" ({', '.join(told + more)}); choose another --output"


def save_agent(path: Path, network: Network, surface: Surface) -> Path:
    """Write a network with what it takes to make it again; give `path`. Raises EnvCraftError."""
    told = {"surface": msgspec.to_builtins(surface), "size": network.size, "head": network.head}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    new = path.with_name(f"{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        new.write_bytes(safetensors.torch.save(tensors, {"envcraft": json.dumps(told, sort_keys=True)}))
        os.replace(new, path)
    except OSError as error:
        raise EnvCraftError(f"{path} cannot be written: {error.strerror or error}") from None
    return path


def load_agent(path: Path) -> tuple[Network, Surface]:
    """Make the network that :func:`save_agent` wrote. Raises UsageError."""
    try:
        with safe_open(path, "pt") as file:
            told = json.loads((file.metadata() or {})["envcraft"])
            surface = msgspec.convert(told["surface"], Surface)
            with weights_from(0):
                network = Network(surface.shape, surface.choices, told["size"], told["head"])
            names = file.keys()
            tensors = {name: file.get_tensor(name) for name in names}
            network.load_state_dict(tensors)
    except _UNREADABLE as error:
        raise UsageError(f"{path} is no agent that `envcraft train` wrote: {type(error).__name__}: {error}") from None
    if not all(isfinite(tensor).all() for tensor in tensors.values()):
        raise UsageError(f"{path} has weights that are no finite numbers, as a training that failed leaves them")
    return network, surface
