"""One task of a study, as bytes, and the doing of it in whichever process an executor runs that."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.errors import EnvCraftError
from envcraft_dqn.study.metric import Score
from envcraft_dqn.study.places import Chosen, Place
from envcraft_dqn.study.protocol import NOOP, PRIVILEGED, RANDOM, UNTRAINED, Protocol, Task, training_settings

if TYPE_CHECKING:
    from envcraft_dqn.recorded import Recorded

#: Seconds between two checkpoints of a training.
_EVERY = 120.0


class Order(msgspec.Struct, frozen=True):
    """A task, with what it takes to do it anywhere that `folder`, the study's, and the corpus can be seen.

    Attributes:
        player: the name of the privileged one.
        environments: all of the study.
        device, sandbox: what to learn on, and where the privileged player plays.
    """

    protocol: Protocol
    place: Place
    folder: str
    task: Task
    player: str
    environments: list[Chosen]
    device: str
    sandbox: str


class Result(msgspec.Struct, frozen=True):
    """What came out. All but `seconds` and `processor_seconds` is the same whenever it is done again.

    Attributes:
        scores: of ``play``, one an environment.
        curve: of ``train``.
        parameters: of the network.
        updates, steps: of the training.
    """

    task: Task
    seconds: float
    processor_seconds: float
    scores: list[Score] = []
    curve: list[dict[str, Any]] = []
    parameters: int = 0
    updates: int = 0
    steps: int = 0


def perform(order: bytes) -> bytes:
    """Do one task: an :class:`Order` as MessagePack in, a :class:`Result` as JSON out. Raises EnvCraftError."""
    told = msgspec.msgpack.decode(order, type=Order)
    began, spent = time.perf_counter(), time.process_time()
    if told.task.player == PRIVILEGED:
        found: dict[str, Any] = {"scores": _privileged(told)}
    else:
        import torch

        # Sums come out in another order with another number.
        torch.set_num_threads(told.protocol.threads)
        found = _trained(told) if told.task.kind == "train" else {"scores": _played(told)}
    result = Result(told.task, time.perf_counter() - began, time.process_time() - spent, **found)
    return msgspec.json.encode(result)


def _trained(told: Order) -> dict[str, Any]:
    import json

    from envcraft_dqn.checkpoint import load_agent
    from envcraft_dqn.learner import train
    from envcraft_dqn.places import sources
    from envcraft_dqn.study.curve import Curve, read

    folder = Path(told.folder, "runs", told.task.name)
    settings = msgspec.structs.replace(training_settings(told.protocol, told.task), device=told.device)
    corpus = Path(told.place.corpus)
    source = _recorded(told) if told.task.demonstrations else None
    file = folder / "curve.jsonl"
    names = told.task.environments
    agent = train(settings, names, told.place.open, folder, source, Curve(file), _EVERY, sources(corpus, names, None))
    numbers = json.loads((folder / "checkpoint" / "state.json").read_text("utf-8"))["numbers"]
    return {
        "curve": read(file),
        "parameters": load_agent(agent)[0].parameter_count,
        "updates": numbers["updates"],
        "steps": numbers["steps"],
    }


def _recorded(told: Order) -> Recorded:
    """What was recorded for this study: in all environments under the contract of the first."""
    from envcraft_dqn.places import contracts
    from envcraft_dqn.recorded import Recorded
    from envcraft_dqn.study.privileged import player_for

    names, corpus = [one.name for one in told.environments], Path(told.place.corpus)
    [promised] = contracts(corpus, names[:1], None).values()
    digest = player_for(told.environments).digest
    return Recorded(corpus, told.place.open, told.player, told.protocol.seed, dict.fromkeys(names, promised), digest)


def _played(told: Order) -> list[Score]:
    from envcraft_dqn.evaluation import AgentPlayer, Player, evaluate, player_named
    from envcraft_dqn.spaces import Surface

    protocol, task = told.protocol, told.task
    surface = Surface.of(told.place.open, task.environments[0])
    if task.player in (RANDOM, NOOP):
        player: Player = player_named(task.player, surface, task.seed)
    else:
        file = Path(told.folder, task.player)
        if task.player == UNTRAINED:
            file = _untrained(told, surface)
        if not file.is_file():
            raise EnvCraftError(f"{file} is missing: all processes of a study must see one folder")
        player = AgentPlayer(file, surface, task.seed, protocol.epsilon, told.device)
    found = evaluate(task.environments, told.place.open, player, protocol.episodes, protocol.lanes, task.seed)
    return [Score.of(one) for one in found]


def _untrained(told: Order, surface: Any) -> Path:
    """A network that has learnt nothing, another one in each split."""
    from envcraft_dqn.checkpoint import save_agent
    from envcraft_dqn.learner import Learner

    settings = msgspec.structs.replace(told.protocol.settings, seed=told.task.seed, device=told.device)
    file = Path(told.folder, "runs", told.task.name, "agent.safetensors")
    return save_agent(file, Learner(settings, surface).network, surface)


def _privileged(told: Order) -> list[Score]:
    from envcraft_dqn.study.privileged import player_for, scores

    return scores(
        Path(told.place.corpus),
        told.task.environments,
        player_for(told.environments),
        told.protocol.privileged_episodes,
        told.protocol.seed,
        told.sandbox,
    )
