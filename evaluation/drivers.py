"""Stand-ins for sandbox drivers."""

from __future__ import annotations

from envcraft_protocol.jobs import Job

from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Player, Recorder, Worker
from envcraft.model.job import JobResult


class _IdleWorker(Worker):
    def __init__(self) -> None:
        self.about = {}

    def preload(self, modules: list[str]) -> list[str]:
        return modules

    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        return [], []

    def run(self, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
        raise AssertionError("an idle worker runs no jobs")

    def close(self) -> None:
        pass


class IdleDriver(Driver):
    """A sandbox whose workers run no jobs, for checks that play nothing."""

    name = "none"
    isolation = Isolation.PROCESS
    rank = 1

    def probe(self) -> Availability:
        return Availability(True)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return _IdleWorker()
