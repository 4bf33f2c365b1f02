"""The tasks of a study as messages, and their execution in a worker process."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.errors import EnvCraftError
from envcraft_dqn.study.metric import Score
from envcraft_dqn.study.protocol import (
    COIN,
    CONSTANT,
    NOOP,
    PRIVILEGED,
    RANDOM,
    SHUFFLED,
    UNTRAINED,
    Protocol,
    Task,
    training_settings,
)
from envcraft_dqn.study.selection import EnvFactory, StudyEnv

if TYPE_CHECKING:
    from envcraft_dqn.demonstrations import Adviser
    from envcraft_dqn.env_spec import EnvSpec
    from envcraft_dqn.policies import Policy
    from envcraft_dqn.recordings import RecordedDemonstrations

#: Seconds between two checkpoints of a training.
_CHECKPOINT_SECONDS = 120.0


class TaskRequest(msgspec.Struct, frozen=True):
    """A task with its context. It can run wherever `folder` and the corpus are accessible.

    Attributes:
        protocol: The protocol of the study.
        factory: Makes the environments.
        folder: The folder of the study.
        task: The task.
        player: The name of the privileged player.
        environments: All environments of the study.
        device: The torch device.
        sandbox: The sandbox of the privileged player.
    """

    protocol: Protocol
    factory: EnvFactory
    folder: str
    task: Task
    player: str
    environments: list[StudyEnv]
    device: str
    sandbox: str


class TaskResult(msgspec.Struct, frozen=True):
    """The result of a task. It is reproducible except for the times.

    Attributes:
        task: The task.
        seconds, processor_seconds: The wall-clock and processor time.
        scores: The scores of a ``play`` task by environment.
        curve: The learning curve of a ``train`` task.
        parameters: The number of parameters of the network.
        updates, steps: The length of the training.
        precision: The precision of the training: bf16 or fp32.
        actions: For ``play`` on frames, how often each joint action was chosen.
    """

    task: Task
    seconds: float
    processor_seconds: float
    scores: list[Score] = []
    curve: list[dict[str, Any]] = []
    parameters: int = 0
    updates: int = 0
    steps: int = 0
    precision: str = ""
    actions: list[int] = []


def run_task(data: bytes) -> bytes:
    """Run one task.

    Args:
        data: A :class:`TaskRequest` as MessagePack.

    Returns:
        A :class:`TaskResult` as JSON.

    Raises:
        EnvCraftError: The task fails.
    """
    request = msgspec.msgpack.decode(data, type=TaskRequest)
    started, spent = time.perf_counter(), time.process_time()
    if request.task.player == PRIVILEGED:
        fields: dict[str, Any] = {"scores": _play_privileged(request)}
    else:
        import torch

        # The number of threads affects the order of floating-point sums.
        torch.set_num_threads(request.protocol.threads)
        fields = _train(request) if request.task.kind == "train" else _play(request)
    result = TaskResult(request.task, time.perf_counter() - started, time.process_time() - spent, **fields)
    return msgspec.json.encode(result)


def _train(request: TaskRequest) -> dict[str, Any]:
    import json

    from envcraft_dqn.checkpoint import load_agent
    from envcraft_dqn.env_spec import advises
    from envcraft_dqn.selection import source_digests
    from envcraft_dqn.study.curve import LearningCurve, read
    from envcraft_dqn.trainer import train

    task = request.task
    folder = Path(request.folder, "runs", task.name)
    settings = msgspec.structs.replace(training_settings(request.protocol, task), device=request.device)
    demonstrations = _demonstrations(request) if task.demonstrations and request.protocol.recorded else None
    open_vector = request.factory.open
    by_player = settings.objective == "dagger" and not advises(open_vector, task.environments[0])
    adviser = _adviser(request) if by_player else None
    file = folder / "curve.jsonl"
    sources = source_digests(Path(request.factory.corpus), task.environments, None)
    agent = train(
        settings,
        task.environments,
        open_vector,
        folder,
        demonstrations,
        LearningCurve(file),
        _CHECKPOINT_SECONDS,
        sources,
        adviser,
        Path(request.folder, task.initial) if task.initial else None,
    )
    numbers = json.loads((folder / "checkpoint" / "state.json").read_text("utf-8"))["numbers"]
    return {
        "curve": read(file),
        "parameters": load_agent(agent)[0].parameter_count,
        "updates": numbers["updates"],
        "steps": numbers["steps"],
        "precision": numbers["precision"],
    }


def _demonstrations(request: TaskRequest) -> RecordedDemonstrations:
    """The recordings of this study, all under the contract of the first environment."""
    from envcraft_dqn.recordings import RecordedDemonstrations
    from envcraft_dqn.selection import contract_digests
    from envcraft_dqn.study.privileged import player_for

    names, corpus = [one.name for one in request.environments], Path(request.factory.corpus)
    [contract] = contract_digests(corpus, names[:1], None).values()
    contracts = dict.fromkeys(names, contract)
    one_family = len({one.family for one in request.environments}) == 1
    player = player_for(request.environments) if one_family else None
    return RecordedDemonstrations(
        corpus,
        request.factory.open,
        player.name if player else None,
        request.protocol.seed,
        contracts,
        player.digest if player else None,
    )


def _adviser(request: TaskRequest) -> Adviser:
    from envcraft_dqn.privileged import FamilyAdviser, PlayerAdviser
    from envcraft_dqn.study.privileged import player_for

    families: dict[str, list[StudyEnv]] = {}
    for one in request.environments:
        families.setdefault(one.family, []).append(one)
    corpus = Path(request.factory.corpus)
    advisers = {
        family: PlayerAdviser(player_for(some), corpus, None, request.sandbox, 1) for family, some in families.items()
    }
    return FamilyAdviser({one.name: advisers[one.family] for one in request.environments})


def _play(request: TaskRequest) -> dict[str, Any]:
    from envcraft_dqn.env_spec import EnvSpec
    from envcraft_dqn.evaluation import evaluate
    from envcraft_dqn.policies import CountingPolicy

    protocol, task = request.protocol, request.task
    spec = EnvSpec.of(request.factory.open, task.environments[0])
    policy = CountingPolicy(_policy(request, spec), spec.num_actions)
    results = evaluate(task.environments, request.factory.open, policy, protocol.episodes, protocol.num_envs, task.seed)
    return {"scores": [Score.of(one) for one in results], "actions": policy.counts.tolist()}


def _best_constant(request: TaskRequest, spec: EnvSpec) -> int:
    """The joint action whose constant play has the highest mean return in environments of the training.

    Returns are standardised over the actions in each environment, so that all environments count the same.
    """
    import numpy as np

    from envcraft_dqn.evaluation import evaluate
    from envcraft_dqn.policies import NoopPolicy

    protocol, task = request.protocol, request.task
    episodes = max(protocol.episodes // 5, 2)
    returns = np.array(
        [
            [
                one.total.mean
                for one in evaluate(
                    task.training, request.factory.open, NoopPolicy(joint), episodes, protocol.num_envs, task.seed
                )
            ]
            for joint in range(spec.num_actions)
        ]
    )
    spread = returns.std(0)
    return int(((returns - returns.mean(0)) / np.where(spread > 0, spread, 1.0)).mean(1).argmax())


def _policy(request: TaskRequest, spec: EnvSpec) -> Policy:
    from envcraft_dqn.policies import AgentPolicy, CoinPolicy, NoopPolicy, ShuffledPolicy, policy_named

    task = request.task
    if task.player in (RANDOM, NOOP):
        return policy_named(task.player, spec, task.seed)
    if task.player == COIN:
        return CoinPolicy(spec, task.seed)
    if task.player == CONSTANT:
        return NoopPolicy(_best_constant(request, spec))
    if task.player == SHUFFLED:
        file = Path(request.folder, "results", f"{task.after[0]}.json")
        return ShuffledPolicy(msgspec.json.decode(file.read_bytes(), type=TaskResult).actions, task.seed)
    file = untrained_agent(request, spec) if task.player == UNTRAINED else Path(request.folder, task.player)
    if not file.is_file():
        raise EnvCraftError(f"{file} is missing: all processes of a study must see the same folder")
    return AgentPolicy(file, spec, task.seed, request.protocol.epsilon, request.device)


def untrained_agent(request: TaskRequest, spec: EnvSpec) -> Path:
    """Write an untrained agent with the seed of the task, which differs between splits."""
    from envcraft_dqn.checkpoint import save_agent
    from envcraft_dqn.learner import Learner

    settings = msgspec.structs.replace(request.protocol.settings, seed=request.task.seed, device=request.device)
    file = Path(request.folder, "runs", request.task.name, "agent.safetensors")
    return save_agent(file, Learner(settings, spec).network, spec)


def _play_privileged(request: TaskRequest) -> list[Score]:
    from envcraft_dqn.study.privileged import player_for, scores

    return scores(
        Path(request.factory.corpus),
        request.task.environments,
        player_for([one for one in request.environments if one.name in request.task.environments]),
        request.protocol.privileged_episodes,
        request.protocol.seed,
        request.sandbox,
    )
