"""A study, from its environments to its report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from envcraft.corpus.executors import ExecutorPlugin
from envcraft.errors import EnvCraftError, UsageError
from envcraft.text import plural
from envcraft_dqn.files import exclusive, write_atomically
from envcraft_dqn.study import privileged, runner, selection
from envcraft_dqn.study.protocol import Protocol, Task, tasks
from envcraft_dqn.study.selection import EnvFactory, StudyEnv
from envcraft_dqn.study.transfer import summarise_transfer, transfer_tasks
from envcraft_dqn.study.worker import TaskRequest

_PLAN = "study.json"


class _Plan(msgspec.Struct, frozen=True):
    """The identity of a study, which its folder stores."""

    protocol: Protocol
    environments: list[StudyEnv]
    player: str


class Experiment:
    """A study whose environments exist.

    Args:
        protocol: The protocol.
        folder: The folder of the study.
        factory: Makes its environments.
        environments: Its environments.
        player: The name of the privileged player.
        device: The torch device.
        sandbox: The sandbox of the privileged player.
        transfer: The numbers of steps in a family that the training left out; None studies generalisation.

    Raises:
        UsageError: The folder has another study.
        EnvCraftError: The folder cannot be written.
    """

    def __init__(
        self,
        protocol: Protocol,
        folder: Path,
        factory: EnvFactory,
        environments: list[StudyEnv],
        player: str,
        device: str,
        sandbox: str,
        transfer: Sequence[int] | None = None,
    ) -> None:
        self.protocol, self.folder, self.environments = protocol, folder, environments
        self._transfer = transfer
        if transfer is None:
            self.tasks = tasks(protocol, [one.name for one in environments])
        else:
            self.tasks = transfer_tasks(protocol, environments, transfer)
        self._factory, self._player, self._device, self._sandbox = factory, player, device, sandbox
        self._claim(_Plan(protocol, environments, player))

    @classmethod
    def prepare(
        cls,
        protocol: Protocol,
        corpus: Path | None,
        folder: Path,
        patterns: Sequence[str],
        metric: str,
        sandbox: str,
        device: str,
        workers: int | None,
    ) -> Experiment:
        """Select or generate the environments, and record missing demonstrations.

        Args:
            protocol: The protocol, whose metric and number of variants are replaced.
            corpus: The corpus; None generates variants into a corpus in `folder`.
            folder: The folder of the study.
            patterns: Shell patterns of names of environments.
            metric: ``length``, ``return``, or ``auto`` for return if the privileged player plays.
            sandbox: The sandbox of the privileged player.
            device: The torch device.
            workers: The number of processes; by default, one per core.

        Raises:
            UsageError: The environments cannot be used, or the options are incompatible.
            EnvCraftError: The privileged player fails.
        """
        if metric == "auto":
            metric = "return" if protocol.privileged_episodes else "length"
        protocol = msgspec.structs.replace(protocol, metric=metric)
        if corpus is None:
            # Incompatible options are reported before anything is written.
            tasks(protocol, [str(number) for number in range(protocol.variants)])
            root = selection.generate(folder / "corpus", protocol.variants, protocol.seed, where=protocol.where)
        else:
            root = corpus
            protocol = msgspec.structs.replace(protocol, where=())
        environments = selection.select(root, patterns)
        protocol = msgspec.structs.replace(protocol, variants=len(environments))
        # Incompatible options are reported before demonstrations are recorded.
        names = [one.name for one in environments]
        tasks(protocol, names)
        factory = selection.factory_for(root.resolve(), environments)
        player = privileged.player_for(environments)
        experiment = cls(protocol, folder, factory, environments, player.name, device, sandbox)
        if protocol.recorded:
            privileged.record(root, names, player, protocol.recorded, protocol.seed, sandbox, workers or None)
        return experiment

    @classmethod
    def prepare_transfer(
        cls,
        protocol: Protocol,
        folder: Path,
        families: Sequence[str],
        steps: Sequence[int],
        sandbox: str,
        device: str,
        workers: int | None,
    ) -> Experiment:
        """Generate the variants of families, and record missing demonstrations by the player of each family.

        Args:
            protocol: The protocol, with the number of variants of each family.
            folder: The folder of the study.
            families: The families, at least two.
            steps: The numbers of steps of further training.
            sandbox: The sandbox of the privileged players.
            device: The torch device.
            workers: The number of processes; by default, one per core.

        Raises:
            UsageError: There are fewer than two families, or the options are incompatible.
            EnvCraftError: A privileged player fails.
        """
        if len(set(families)) < 2:
            raise UsageError(f"a transfer needs two families or more, not {' and '.join(families) or 'none'}")
        root = selection.generate(folder / "corpus", protocol.variants, protocol.seed, families)
        environments = selection.select(root, ())
        factory = selection.factory_for(root.resolve(), environments, generated=True)
        players = {
            family: privileged.player_for([one for one in environments if one.family == family])
            for family in sorted(set(families))
        }
        names = " and ".join(dict.fromkeys(player.name for player in players.values()))
        experiment = cls(protocol, folder, factory, environments, names, device, sandbox, steps)
        for family, player in players.items():
            own = [one.name for one in environments if one.family == family]
            if protocol.recorded:
                privileged.record(root, own, player, protocol.recorded, protocol.seed, sandbox, workers or None)
        return experiment

    def summary(self) -> str:
        """The size of the study as text."""
        return f"{plural(len(self.environments), 'environment')} in {plural(self.protocol.folds, 'fold')}, " + plural(
            len(self.tasks), "task"
        )

    def run(
        self, plugin: ExecutorPlugin, workers: int | None, scheduler: str | None, on_result: runner.OnResult
    ) -> Path:
        """Run the remaining tasks and write the report; return its file. See :func:`runner.run` for the arguments."""
        from envcraft_dqn.study.report import write, write_transfer
        from envcraft_dqn.study.summary import summarise

        with exclusive(self.folder):
            results = runner.run(self.tasks, self._request, self.folder, plugin, workers, scheduler, on_result)
            if self._transfer is not None:
                summary = summarise_transfer(self.protocol, self._player, results, self.environments)
                return write_transfer(self.folder, summary)
            kinds = {one.name: one.kind for one in self.environments}
            return write(self.folder, self.protocol, self._player, results, summarise(self.protocol, results, kinds))

    def _request(self, task: Task) -> TaskRequest:
        folder = str(self.folder.resolve())
        return TaskRequest(
            self.protocol, self._factory, folder, task, self._player, self.environments, self._device, self._sandbox
        )

    def _claim(self, plan: _Plan) -> None:
        """Store the identity of the study in its folder. Raises UsageError if the folder has another study."""
        file = self.folder / _PLAN
        data = msgspec.json.format(msgspec.json.encode(plan), indent=1) + b"\n"
        try:
            if not file.is_file():
                write_atomically(file, data)
            elif file.read_bytes() != data:
                raise UsageError(f"{file} belongs to another study; choose another --output, or the same options")
        except OSError as error:
            raise EnvCraftError(f"{file} cannot be written: {error.strerror or error}") from None
