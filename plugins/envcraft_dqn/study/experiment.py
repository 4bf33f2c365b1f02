"""A study from its first environment to its report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from envcraft.errors import EnvCraftError, UsageError
from envcraft.executors import ExecutorPlugin
from envcraft.reports import plural
from envcraft_dqn.lock import alone
from envcraft_dqn.study import places, privileged, running
from envcraft_dqn.study.places import Chosen, Place
from envcraft_dqn.study.protocol import Protocol, Task, tasks
from envcraft_dqn.study.work import Order

_PLAN = "study.json"


class _Plan(msgspec.Struct, frozen=True):
    """What a folder's results are of."""

    protocol: Protocol
    environments: list[Chosen]
    player: str


class Experiment:
    """A study whose environments and demonstrations are there, and which may have been begun."""

    def __init__(
        self,
        protocol: Protocol,
        folder: Path,
        place: Place,
        environments: list[Chosen],
        player: str,
        device: str,
        sandbox: str,
    ) -> None:
        """Raises UsageError where the folder has another study."""
        self.protocol, self.folder, self.environments = protocol, folder, environments
        self.tasks = tasks(protocol, [one.name for one in environments])
        self._place, self._player, self._device, self._sandbox = place, player, device, sandbox
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
        """Write the environments where no corpus is named, and record the demonstrations that are missing.

        Raises UsageError where the environments cannot be used, EnvCraftError where they cannot be played.
        """
        if corpus is None:
            # What does not go together is told before anything is written.
            tasks(protocol, [str(number) for number in range(protocol.variants)])
            root = places.written(folder / "corpus", protocol.variants, protocol.seed)
        else:
            root = corpus
        environments = places.chosen(root, patterns)
        if metric == "auto":
            metric = "length" if all(one.family == places.FAMILY for one in environments) else "return"
        protocol = msgspec.structs.replace(protocol, metric=metric, variants=len(environments))
        # Before anything that takes time.
        names = [one.name for one in environments]
        tasks(protocol, names)
        place = places.place_of(root.resolve(), environments)
        player = privileged.player_for(environments)
        experiment = cls(protocol, folder, place, environments, player.name, device, sandbox)
        steps = protocol.settings.demonstrations
        privileged.record(root, names, player, steps, protocol.seed, sandbox, workers or None)
        return experiment

    def told(self) -> str:
        """In words, how much there is to do."""
        return f"{plural(len(self.environments), 'environment')} in {plural(self.protocol.folds, 'fold')}, " + plural(
            len(self.tasks), "task"
        )

    def run(self, plugin: ExecutorPlugin, workers: int | None, scheduler: str | None, tell: running.Tell) -> Path:
        """Do what is left to do, and write the report; give its file."""
        from envcraft_dqn.study.report import write
        from envcraft_dqn.study.summary import summarise

        with alone(self.folder):
            results = running.run(self.tasks, self._order, self.folder, plugin, workers, scheduler, tell)
            kinds = {one.name: one.kind for one in self.environments}
            return write(self.folder, self.protocol, self._player, results, summarise(self.protocol, results, kinds))

    def _order(self, task: Task) -> Order:
        folder = str(self.folder.resolve())
        return Order(
            self.protocol, self._place, folder, task, self._player, self.environments, self._device, self._sandbox
        )

    def _claim(self, plan: _Plan) -> None:
        """Write down what the folder is for. Raises UsageError where that is something else."""
        file = self.folder / _PLAN
        data = msgspec.json.format(msgspec.json.encode(plan), indent=1) + b"\n"
        try:
            if file.is_file():
                if file.read_bytes() != data:
                    raise UsageError(f"{file} is that of another study; choose another --output, or the same options")
                return
            self.folder.mkdir(parents=True, exist_ok=True)
            new = file.with_suffix(".new")
            new.write_bytes(data)
            os.replace(new, file)
        except OSError as error:
            raise EnvCraftError(f"{file} cannot be written: {error.strerror or error}") from None
