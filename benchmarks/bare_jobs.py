"""The cost of a validation's jobs without a sandbox: the same episodes and searches in a plain loop in one process.

An episode follows the conditions of its job: earlier episodes on the same instance, a second instance beside it, calls
of render(), steps past the end and a reset after it. A search is that of the worker, with its copies of the state and
without messages.
"""

from __future__ import annotations

import contextlib
import random
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from envcraft_protocol.jobs import Episode, Job
from envcraft_sandbox.worker import search
from envcraft_sandbox.worker.channel import Channel
from envcraft_sandbox.worker.subject import Fault, Subject

from envcraft.judging.driver import Availability, Driver, Limits, Worker
from envcraft.judging.engine import Plan, validate


class _NullChannel(Channel):
    """A channel that discards its messages."""

    def __init__(self) -> None:
        super().__init__(socket.socket(socket.AF_UNIX))

    def _write(self, parts: list[bytes], size: int) -> None:
        pass


class RecordingDriver(Driver):
    """A driver that records the jobs of its workers."""

    def __init__(self, driver: Driver) -> None:
        self.name, self.isolation, self.rank = driver.name, driver.isolation, driver.rank
        self.jobs: list[Job] = []
        self._driver = driver

    def probe(self) -> Availability:
        return self._driver.probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        worker = self._driver.launch(hash_seed=hash_seed, limits=limits)
        run = worker.run

        def record(job: Job, recording: Any, *rest: Any) -> Any:
            end = run(job, recording, *rest)
            # The trace has the actions that the host chose during the episode.
            self.jobs.append({**job, "actions": recording.trace.actions} if job.get("interactive") else job)
            return end

        worker.run = record  # type: ignore[method-assign, assignment]
        return worker


def jobs_of(plan: Plan) -> list[Job]:
    """The jobs of a validation by this plan."""
    driver = RecordingDriver(plan.driver)
    for _ in validate(
        Plan(plan.targets, plan.contract, driver, plan.checks, plan.budget, plan.seed, parallel_jobs=1), 1
    ):
        pass
    return driver.jobs


def seconds(job: Job) -> float:
    """CPU seconds of one job in this process. An exception of the environment ends the job."""
    state = job.get("seed", 0) % 2**32
    random.seed(state)
    np.random.seed(state)
    subject = Subject(job, _NullChannel())
    started = time.process_time()
    with contextlib.suppress(Exception, Fault):
        subject.load()
        if job["kind"] == "rollout":
            _episode(subject, job)
        elif job["kind"] == "search":
            search.run(subject, job)
        else:
            subject.construct()
    return time.process_time() - started


def _episode(subject: Subject, job: Job) -> None:
    conditions = job.get("conditions", {})
    for _ in range(2 if conditions.get("again") else 1):
        if conditions.get("closed"):
            subject.construct(announce=False).close()
        env = subject.construct(announce=False)
        for earlier in conditions.get("before", ()):
            _play(subject, env, earlier["seed"], earlier["actions"])
        beside = _companion(subject, conditions["companion"]) if "companion" in conditions else None
        seed = None if conditions.get("unseeded") else job["seed"]
        ended = _play(subject, env, seed, job["actions"], beside, env.render if conditions.get("render") else None)
        if ended:
            _play_on(subject, env, (job["actions"] * 2)[: conditions.get("after_end", 0)])
        if "options" in job:
            env.reset(seed=None, options=None)
        env.close()


def _play(
    subject: Subject,
    env: Any,
    seed: int | None,
    actions: list[Any],
    beside: Iterator[None] | None = None,
    render: Callable[[], Any] | None = None,
) -> bool:
    """Play an episode; return whether it has ended."""
    env.reset(seed=seed)
    for action in actions:
        _, _, terminated, truncated, _ = env.step(subject.action(action, env))
        if beside:
            next(beside)
        if render:
            render()
        if terminated or truncated:
            return True
    return False


def _play_on(subject: Subject, env: Any, actions: list[Any]) -> None:
    """Steps past the end, up to the first exception."""
    with contextlib.suppress(Exception):
        for action in actions:
            env.step(subject.action(action, env))


def _companion(subject: Subject, plan: Episode) -> Iterator[None]:
    env, seed = subject.construct(announce=False), plan["seed"]
    while True:
        env.reset(seed=seed)
        seed += 1
        for action in plan["actions"]:
            _, _, terminated, truncated, _ = env.step(subject.action(action, env))
            yield
            if terminated or truncated:
                break
