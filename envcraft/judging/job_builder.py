"""Turns requests for rollouts and searches into jobs for the worker."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from envcraft.judging.budget import Budget
from envcraft.judging.coverage import Coverage
from envcraft.judging.facts import Facts
from envcraft.judging.job_scheduler import Placement
from envcraft.judging.probes import Probes
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.model.contract import Contract
from envcraft.model.rollout import Action, Conditions, Rollout, Search
from envcraft.model.target import PolicyFile
from envcraft.similarity.behavioural import STEPS

if TYPE_CHECKING:
    from envcraft_protocol.jobs import Job

#: The share of a job's time after which a search returns what it has, so that slow steps cost no more.
_SEARCH_SHARE = 0.2
#: Seconds of processor time after which no further recorded episode starts.
_RECORDED_SECONDS = 10.0


class PreparedJob(NamedTuple):
    """A job, the worker that it needs, and what receives its messages."""

    placement: Placement
    job: Job
    builder: TraceBuilder


class JobBuilder:
    """Makes the jobs of one subject.

    Args:
        facts: of the target.
        contract: what the environment promises.
        budget: how much the validation spends.
        seed: the seed of the validation.
        policy: the privileged policy, if there is one.
        job_seconds: the longest time of one job.
        coverage: the marked statements.
    """

    def __init__(
        self,
        facts: Facts,
        contract: Contract,
        budget: Budget,
        seed: int,
        policy: PolicyFile | None,
        job_seconds: float,
        coverage: Coverage,
    ) -> None:
        self._facts = facts
        self._contract = contract
        self._budget = budget
        self._seed = seed
        self._policy = policy
        self._job_seconds = job_seconds
        self._marks = [list(place) for place in coverage.places]

    @cached_property
    def probes(self) -> Probes:
        """The episodes that checks request. Raises Skip where no actions can be drawn."""
        return Probes(self._contract, self._budget, self._seed, self._facts.action_space)

    def search(self, search: Search, series: bool) -> PreparedJob:
        """The job of a search; with `series` it may run in a process with others."""
        length = self.probes.length
        job = self._facts.job("search")
        job |= {"search": search.kind, "seed": search.seed, "path": search.path, "actions": self.probes.joint_actions}
        job |= {"max_steps": search.budget, "limit": length, "seconds": self._job_seconds * _SEARCH_SHARE}
        job |= {"series": series, "marks": self._marks}
        if search.counter is not None:
            job["counter"] = search.counter
        rollout = Rollout(search.seed, [], max_steps=length)
        return PreparedJob(Placement(), job, TraceBuilder(rollout, None, self._facts.action_space))

    def rollout(
        self,
        rollout: Rollout,
        *,
        again: bool = False,
        series: bool = False,
        new_process: bool = False,
        every_step: bool = False,
        measured: float | None = None,
        columns: bool | None = None,
        kind: type[TraceBuilder] = TraceBuilder,
    ) -> PreparedJob:
        """The job of a rollout.

        Args:
            rollout: the request.
            again: it runs although its trace is known: a fresh one in a worker of its own.
            series: it may run in a process with others.
            new_process: nothing runs before it in its process.
            every_step: send each step at once.
            measured: measure the episode for so many seconds, and count the steps that wait for something.
            columns: how long frames are read for their digests; None: as the job's first one lies in memory.
            kind: what receives the messages.
        """
        conditions = rollout.conditions
        job = self._facts.job("rollout")
        job |= {"seed": rollout.seed, "actions": rollout.actions, "max_steps": rollout.max_steps}
        job["conditions"] = conditions.to_json()
        if conditions.options:
            job["options"] = {}
        if rollout.policy and self._policy is not None:
            job["policy"] = {"source": self._policy.source, "filename": "<envcraft_policy>"}
        if rollout.fields:
            job["fields"] = True
        if every_step:
            job["every_step"] = True
        if not (measured or rollout.interactive):
            job["marks"] = self._marks
        if measured is not None:
            job |= {"count_waits": True, "seconds": measured}
        if conditions.recorded:
            job["seconds"] = _RECORDED_SECONDS
        if rollout.interactive:
            job["interactive"] = True
        if series:
            job["series"] = True
            job["new_process"] = new_process
        if conditions.fresh or conditions.hash_seed:
            own = conditions.fresh and again
            placement = Placement(conditions.hash_seed, separate=not own, own=own)
        else:
            # Checks compare conditions with the plain run. In its worker nothing else differs.
            placement = Placement(group=rollout.under(Conditions()).key())
        builder = kind(
            rollout,
            self._facts.observation_space,
            self._facts.action_space,
            exact=self._contract.observation is not None,
            success=self._contract.success,
            watch=self._watches(rollout),
            resize=self._resize,
        )
        job["pictures"] = builder.pictures
        if builder.frame is not None:
            job["frame"] = list(builder.frame)
            if columns is not None:
                job["columns"] = columns
        return PreparedJob(placement, job, builder)

    @property
    def _resize(self) -> tuple[int, int] | None:
        size = self._contract.adapter.get("resize")
        return (size[0], size[1]) if size else None

    @cached_property
    def _watched(self) -> list[Action]:
        """The first actions of the episode that the fingerprint is made of; they do not depend on the budget."""
        return self.probes.sticky(0).actions[:STEPS]

    def _watches(self, rollout: Rollout) -> bool:
        plain = not rollout.live and rollout.seed == self.probes.episode_seed(0) and rollout.conditions == Conditions()
        return plain and rollout.actions[:STEPS] == self._watched
