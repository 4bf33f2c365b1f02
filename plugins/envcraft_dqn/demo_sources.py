"""The sources of demonstrations that ``--demos`` names: policies, players of plugins, and recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from envcraft.errors import UsageError
from envcraft_dqn import privileged
from envcraft_dqn.demonstrations import DemonstrationSource, Episode
from envcraft_dqn.env_spec import EnvSpec, OpenVector, spec_of
from envcraft_dqn.policies import NAMES, AgentPolicy, NoopPolicy, Policy, RandomPolicy, policy_named
from envcraft_dqn.recordings import RecordedDemonstrations
from envcraft_dqn.selection import Selection, contract_digests
from envcraft_dqn.settings import Settings


class PolicyDemonstrations:
    """Episodes that a policy plays on demand, from increasing seeds.

    Args:
        open_vector: Makes a vector of named environments.
        policy: The policy.
        steps: The steps in each environment; the last episode is truncated there.
        seed: The first seed.
    """

    def __init__(self, open_vector: OpenVector, policy: Policy, steps: int, seed: int = 0) -> None:
        self._open, self._policy, self._steps, self._seed = open_vector, policy, steps, seed

    def identity(self, names: Sequence[str]) -> str:
        """The identity of the policy."""
        if isinstance(self._policy, AgentPolicy):
            return f"the agent {self._policy.sha256[:16]}"
        return {RandomPolicy: "random", NoopPolicy: "noop"}.get(type(self._policy), "some")

    def episodes(self, name: str) -> Iterator[Episode]:
        """Play episodes in one environment."""
        vector: Any = self._open([name])
        try:
            spec = spec_of(vector, name)
            left, seed = self._steps, self._seed
            while left > 0:
                seen, _ = vector.reset(seed=[seed])
                frames, actions, rewards, done = [seen[0].copy()], [], [], False
                while not done and left > 0:
                    action = spec.split(self._policy.act(seen))
                    seen, reward, terminated, truncated, _ = vector.step(action)
                    frames.append(seen[0].copy())
                    actions.append(action[0])
                    rewards.append(float(reward[0]))
                    done, left = bool(terminated[0] or truncated[0]), left - 1
                yield Episode(np.stack(frames), np.stack(actions), np.array(rewards), bool(terminated[0]))
                seed += 1
        finally:
            vector.close()


def source_named(name: str, selection: Selection, settings: Settings, folder: Path) -> DemonstrationSource:
    """Make a source of demonstrations by name.

    Args:
        name: A policy (``random``, ``noop``, ``checkpoint:PATH``), recordings of ``envcraft demos`` (``CORPUS``,
            ``CORPUS:PLAYER``), or a player of the hook ``envcraft_players``. Such a player records its episodes in a
            sandbox first, unless an earlier run has done so.
        selection: The environments.
        settings: The settings of the run.
        folder: The folder of the run, which stores the recordings of a player.

    Raises:
        UsageError: There is no such source.
        EnvCraftError: The player fails in its sandbox.
    """
    if (player := privileged.players().get(name)) is not None:
        corpus = folder / "demonstrations"
        privileged.record(player, selection, corpus, settings.demonstrations, settings.seed)
        return _recorded(corpus, name, selection, settings.demonstrations, player.digest)
    path, colon, recorded_player = name.rpartition(":")
    if name not in NAMES and Path(name).is_dir():
        return _recorded(Path(name), None, selection, settings.demonstrations)
    if colon and path != "checkpoint" and Path(path).is_dir():
        return _recorded(Path(path), recorded_player, selection, settings.demonstrations)
    spec = EnvSpec.of(selection.open_vector, selection.names[0])
    policy = policy_named(name, spec, settings.seed, device=settings.device)
    return PolicyDemonstrations(selection.open_vector, policy, settings.demonstrations, settings.seed)


def adviser_named(name: str, selection: Selection) -> privileged.PlayerAdviser:
    """The adviser for a source of demonstrations: the player itself, or that of recordings ``CORPUS:PLAYER``.

    Raises:
        UsageError: The source names no player that sees the state.
    """
    known = privileged.players()
    player = known.get(name) or known.get(name.rpartition(":")[2])
    if player is None:
        raise UsageError(f"--demos {name} names no player that can advise; choose from {', '.join(sorted(known))}")
    return privileged.PlayerAdviser(player, selection.target, selection.contract, selection.sandbox, selection.workers)


def _recorded(
    corpus: Path, player: str | None, selection: Selection, steps: int, player_digest: str | None = None
) -> RecordedDemonstrations:
    """The recordings in the selected environments. It warns on stderr if there are too few."""
    names = selection.names
    contracts = contract_digests(selection.target, names, selection.contract)
    source = RecordedDemonstrations(
        corpus, selection.open_vector, player, contracts=contracts, player_digest=player_digest
    )
    if missing := len(set(names) - set(source.names)):
        click.echo(f"{missing:,} of {len(names):,} environments have no demonstrations", err=True)
    if short := [name for name in source.names if source.steps(name) < steps]:
        click.echo(
            f"{len(short):,} of {len(names):,} environments have fewer than {steps:,} steps of demonstrations, "
            f"such as {short[0]} with {source.steps(short[0]):,}",
            err=True,
        )
    return source
