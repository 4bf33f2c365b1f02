"""Exports recordings as data sets in Minari's HDF5 format, one for each environment and player.

A data set names its environment and contains no code: Minari makes the environment by ``envcraft:create``, from the
corpus that ``ENVCRAFT_CORPUS`` names and under that corpus's verdicts.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envcraft.corpus.export.exporter import Exported, Exporter, Order, fresh_folder
from envcraft.errors import UsageError
from envcraft.text import plural

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

    from envcraft.corpus.store.demonstrations import Row
    from envcraft.demonstrations.cache import Cache
    from envcraft.model.contract import Contract

_ROOT = "MINARI_DATASETS_PATH"


class MinariExporter(Exporter):
    name = "minari"
    summary = "Minari data sets of the recordings that envcraft demos --cache made"

    def export(self, order: Order) -> list[str]:
        if importlib.util.find_spec("minari") is None:
            raise UsageError("a Minari data set needs minari: pip install 'envcraft-rl[minari]'")
        if order.licence is not None:
            raise UsageError("--licence applies to --to hf; a Minari data set has no card")
        from envcraft.corpus.store.demonstrations import named

        namespace = _word(order.name or "envcraft")
        exported = {environment.name: environment for environment in order.environments()}
        if not exported:
            raise order.nothing()
        made: list[str] = []
        with fresh_folder(order.output) as folder, _datasets_in(folder):
            for name, row in named(order.store):
                if name in exported:
                    made.append(_write(order, namespace, exported[name], row, made))
            if not made:
                root = order.store.root
                raise UsageError(f"{root} has no recordings; `envcraft demos {root} --cache` makes them")
        return [
            f"{plural(len(made), 'data set')} in {order.output}: with {_ROOT}={order.output} and "
            f"ENVCRAFT_CORPUS={order.store.root}, in Python",
            f'  minari.load_dataset("{made[0]}").recover_environment()',
        ]


def _write(order: Order, namespace: str, environment: Exported, row: Row, taken: list[str]) -> str:
    """Write the data set of a recording, and return its id. Raises UsageError if it has no frame cache."""
    import minari
    from gymnasium.envs.registration import EnvSpec

    from envcraft.contracts.lookup import contract_named
    from envcraft.corpus.ids import identifier
    from envcraft.demonstrations.cache import Cache
    from envcraft.demonstrations.store import cache_path
    from envcraft.environments.registration import ENTRY_POINT

    file = cache_path(order.store, row.file)
    if not file.exists():
        raise UsageError(
            f"{environment.name} has no frame cache; `envcraft demos {order.store.root} --cache` writes it"
        )
    stem = f"{namespace}/{_word(environment.name.removesuffix('.py'))}/{_word(row.player)}"
    number = sum(known.rpartition("-v")[0] == stem for known in taken)
    spec = EnvSpec(
        identifier(environment.name),
        ENTRY_POINT,
        disable_env_checker=True,
        kwargs={"name": environment.name, "contract": row.contract},
    )
    cache = Cache(file)
    with warnings.catch_warnings():
        # Minari asks for an author and a link, which only the publisher of the data knows.
        warnings.simplefilter("ignore", UserWarning)
        minari.create_dataset_from_buffers(
            f"{stem}-v{number}",
            _episodes(cache),
            env=_named(spec, contract_named(row.contract)),
            algorithm_name=row.player,
            # The default is JPEG, which loses information.
            jpeg_encoding=False,
            description=f"{environment.name}, played by {row.player}; the source has SHA-256 {row.source}",
        )
    return f"{stem}-v{number}"


def _episodes(cache: Cache) -> Iterator[Any]:
    """The episodes, one at a time because all frames together would be large."""
    import numpy as np
    from minari.data_collector import EpisodeBuffer

    arrays = cache.arrays
    for number in range(int(arrays["episode"][-1]) + 1):
        places = np.flatnonzero(arrays["episode"] == number)
        shown = [*arrays["observation"][places].tolist(), int(arrays["next_observation"][places[-1]])]
        yield EpisodeBuffer(
            id=number,
            observations=np.stack([cache.read(frame) for frame in shown]),
            actions=arrays["table"][arrays["action"][places]],
            rewards=arrays["reward"][places].tolist(),
            terminations=arrays["terminated"][places].astype(bool).tolist(),
            truncations=arrays["truncated"][places].astype(bool).tolist(),
        )


def _named(spec: EnvSpec, contract: Contract) -> Any:
    """An environment with spaces and a spec only; of a real one Minari would run the code."""
    import gymnasium

    from envcraft.spaces.gymnasium import to_gymnasium
    from envcraft.spaces.spec import read_space

    env: gymnasium.Env[Any, Any] = gymnasium.Env()
    if contract.observation is None or contract.action is None:
        raise UsageError(f"the contract {contract.name} defines no spaces, and Minari needs them")
    env.observation_space = to_gymnasium(read_space(contract.observation), "the observation space")
    env.action_space = to_gymnasium(read_space(contract.action), "the action space")
    env.spec = spec
    return env


def _word(name: str) -> str:
    """A part of a Minari id: letters, digits, `_`, `.` and `-`."""
    return re.sub(r"[^\w.-]", "_", name, flags=re.ASCII)


@contextlib.contextmanager
def _datasets_in(folder: Path) -> Iterator[None]:
    """Make Minari store data sets in this folder."""
    before = os.environ.get(_ROOT)
    # Minari doubles the parts of a relative path.
    os.environ[_ROOT] = str(folder.absolute())
    try:
        yield
    finally:
        if before is None:
            del os.environ[_ROOT]
        else:
            os.environ[_ROOT] = before
