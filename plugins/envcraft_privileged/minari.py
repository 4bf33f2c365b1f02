"""Recordings as data sets of Minari, in its own HDF5: one for each environment and player.

A data set names its environment, and brings no code: Minari recovers it by ``envcraft.using.ids``, from the corpus that
``ENVCRAFT_CORPUS`` names and under that corpus's verdicts.
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

from envcraft.corpus.export import Exported, Exporter, Order, fresh_folder
from envcraft.errors import UsageError
from envcraft.reports import plural

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

    from envcraft.contract import Contract
    from envcraft.demonstrations.cache import Cache
    from envcraft.demonstrations.keeping import Row

_ROOT = "MINARI_DATASETS_PATH"


class MinariExporter(Exporter):
    name = "minari"
    summary = "data sets that Minari loads, of what was recorded of players (envcraft demos --cache)"

    def export(self, order: Order) -> list[str]:
        if importlib.util.find_spec("minari") is None:
            raise UsageError("data sets for Minari need it: pip install 'envcraft-rl[minari]'")
        if order.licence is not None:
            raise UsageError("--licence is for the card of --to hf")
        from envcraft.demonstrations import keeping

        namespace = _word(order.name or "envcraft")
        exported = {environment.name: environment for environment in order.environments()}
        if not exported:
            raise order.nothing()
        made: list[str] = []
        with fresh_folder(order.output) as folder, _datasets_in(folder):
            for name, row in keeping.rows(order.store):
                if name in exported:
                    made.append(_write(order, namespace, exported[name], row, made))
            if not made:
                root = order.store.root
                raise UsageError(f"nothing in {root} was recorded; `envcraft demos {root} --cache` does so")
        return [
            f"{plural(len(made), 'data set')} in {order.output}: with {_ROOT}={order.output} and "
            f"ENVCRAFT_CORPUS={order.store.root}, in Python",
            f'  minari.load_dataset("{made[0]}").recover_environment()',
        ]


def _write(order: Order, namespace: str, environment: Exported, row: Row, taken: list[str]) -> str:
    """Write a recording's data set; give its id. Raises UsageError where its frames were not kept."""
    import minari
    from gymnasium.envs.registration import EnvSpec

    from envcraft.commands.choices import contract_named
    from envcraft.demonstrations import keeping
    from envcraft.demonstrations.cache import Cache
    from envcraft.using.ids import identifier

    file = keeping.cache_place(order.store, row.file)
    if not file.exists():
        raise UsageError(
            f"the frames of {environment.name} were not kept; `envcraft demos {order.store.root} --cache` does so"
        )
    stem = f"{namespace}/{_word(environment.name.removesuffix('.py'))}/{_word(row.player)}"
    number = sum(known.rpartition("-v")[0] == stem for known in taken)
    spec = EnvSpec(
        identifier(environment.name),
        "envcraft.using.ids:create",
        disable_env_checker=True,
        kwargs={"name": environment.name, "contract": row.contract},
    )
    cache = Cache(file)
    with warnings.catch_warnings():
        # It asks for an author and a link, which only whoever publishes the data knows.
        warnings.simplefilter("ignore", UserWarning)
        minari.create_dataset_from_buffers(
            f"{stem}-v{number}",
            _episodes(cache),
            env=_named(spec, contract_named(row.contract)),
            algorithm_name=row.player,
            # By default frames go through JPEG, and come back otherwise.
            jpeg_encoding=False,
            description=f"{environment.name}, played by {row.player}; the source has SHA-256 {row.source}",
        )
    return f"{stem}-v{number}"


def _episodes(cache: Cache) -> Iterator[Any]:
    """The episodes one by one: all of them at once would be large."""
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
    """An environment in name only: Minari would run a real one, for its spaces."""
    import gymnasium

    from envcraft.using.spaces import to_gymnasium

    env: gymnasium.Env[Any, Any] = gymnasium.Env()
    if contract.observation is None or contract.action is None:
        raise UsageError(f"the contract {contract.name} leaves the spaces open, and Minari wants to know them")
    env.observation_space = to_gymnasium(contract.observation, "the observation space")
    env.action_space = to_gymnasium(contract.action, "the action space")
    env.spec = spec
    return env


def _word(name: str) -> str:
    """A part of an id of Minari's: letters, digits, `_`, `.` and `-`."""
    return re.sub(r"[^\w.-]", "_", name, flags=re.ASCII)


@contextlib.contextmanager
def _datasets_in(folder: Path) -> Iterator[None]:
    """Have Minari keep data sets in a folder."""
    before = os.environ.get(_ROOT)
    # Of a relative one Minari takes each of its parts twice.
    os.environ[_ROOT] = str(folder.absolute())
    try:
        yield
    finally:
        if before is None:
            del os.environ[_ROOT]
        else:
            os.environ[_ROOT] = before
