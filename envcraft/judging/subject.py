"""One environment under test, as checks see it: facts of its file, and the rollouts and searches that they request."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from functools import cached_property
from types import TracebackType
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.judging.budget import Budget
from envcraft.judging.coverage import Coverage
from envcraft.judging.driver import Isolation
from envcraft.judging.episodes import Episodes
from envcraft.judging.facts import Facts, Loaded
from envcraft.judging.job_builder import JobBuilder
from envcraft.judging.job_runner import JobRunner
from envcraft.judging.probes import Probes
from envcraft.judging.rollout_cache import RolloutCache
from envcraft.judging.search import Searches
from envcraft.judging.session import Session
from envcraft.judging.time_limit import TimeLimit
from envcraft.judging.worker_pool import Lease
from envcraft.model.contract import Contract
from envcraft.model.rollout import Action, Conditions, Rollout, Search
from envcraft.model.target import PolicyFile, Project, Target
from envcraft.model.trace import Ending, Fault, Trace
from envcraft.model.verdict import Line
from envcraft.similarity.behavioural import fingerprint
from envcraft.spaces.spec import SpaceSpec

if TYPE_CHECKING:
    from envcraft.judging.ignore_comments import IgnoreComments


class Subject:
    """One target under a contract.

    Use it as a context manager, or close it: that ends the workers. Methods that run something raise WorkerLost when
    the sandbox itself fails, which is never the environment's fault, and Skip when the subject has used up its time.

    Args:
        target: what is judged.
        contract: what the environment promises.
        lease: where the workers come from.
        budget: how much the validation spends.
        seed: the seed of the validation.
        policy: the privileged policy, if there is one.
        parallel_jobs: the most jobs that run at a time. No verdict depends on it.
        seconds: the longest time from now on, on the clock; None for that of the budget.

    Attributes:
        cache: the traces and search outcomes so far.
        coverage: the statements of the file, and which of them were reached in these.
        time_limit: when the last job ends.
        ignore_comments: the comments of the file that ignore findings; None if they are not read.
        left_out: the files of its project, if the contract leaves them out.
    """

    def __init__(
        self,
        target: Target,
        contract: Contract,
        lease: Lease,
        budget: Budget,
        seed: int = 0,
        policy: PolicyFile | None = None,
        parallel_jobs: int = 1,
        seconds: float | None = None,
    ) -> None:
        self.left_out: Project | None = None
        if target.project is not None and not (contract.project or target.project.named):
            self.left_out, target = target.project, msgspec.structs.replace(target, project=None)
        self.target = target
        self.contract = contract
        self.lease = lease
        self.budget = budget
        self.seed = seed
        self.policy = policy
        self.time_limit = TimeLimit(budget.seconds if seconds is None else seconds, fixed=seconds is not None)
        self.ignore_comments: IgnoreComments | None = None
        self._runner = JobRunner(lease, target, contract, parallel_jobs, self.time_limit)
        self._facts = Facts(target, contract, self._runner)
        self.coverage = Coverage(target)
        limits = lease.pool.limits
        self._jobs = JobBuilder(self._facts, contract, budget, seed, policy, limits.job, self.coverage)
        self.cache = RolloutCache(self._jobs, self._runner, budget, self.coverage)

    def __enter__(self) -> Subject:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the workers."""
        self._runner.close()
        if "without_wrappers" in vars(self):
            self.without_wrappers.close()

    @cached_property
    def without_wrappers(self) -> Subject:
        """The same environment without its wrappers, for the time that is left."""
        target, lease = msgspec.structs.replace(self.target, wrappers=()), self.lease.pool.lease(ahead=False)
        return Subject(target, self.contract, lease, self.budget, self.seed, seconds=self.time_limit.left)

    # The sandbox

    @property
    def about(self) -> dict[str, Any]:
        """What the first worker reports about itself (:attr:`envcraft.judging.driver.Worker.about`), {} before there is
        one.
        """
        return self._runner.about

    @property
    def isolation(self) -> Isolation:
        """How the workers are isolated."""
        return self._runner.isolation

    @property
    def seconds(self) -> float:
        """How long the requested jobs took, all together."""
        return self._runner.seconds

    @property
    def out_of_time(self) -> bool:
        """Whether the time limit is over."""
        return self.time_limit.over

    def find_modules(self, names: list[str]) -> tuple[list[str], list[str]]:
        """Look modules up in a worker without importing them.

        Returns:
            Those that are not installed, and if there are any, the names of all installed ones.
        """
        return self._runner.find_modules(names)

    # Facts of the file

    def load(self) -> Loaded:
        """Load the file in a worker and construct one instance, once."""
        return self._facts.load()

    @property
    def constructed(self) -> bool:
        """Whether the target was loaded, and its constructor was called."""
        return self._facts.constructed

    @property
    def text(self) -> str:
        """The source as text. Raises UnicodeDecodeError."""
        return self.target.text

    @property
    def env_class(self) -> str | None:
        """The environment's class, if it is known."""
        return self._facts.env_class

    @property
    def class_statement(self) -> str | None:
        """The name that the file's class statement gives the class; "" if the file has no such statement, None if the
        class is not known.
        """
        return self._facts.class_statement

    @property
    def source_sha256(self) -> str:
        """The digest of the file that defines the class. For an installed class the worker reports it."""
        return self._facts.source_sha256

    @property
    def module(self) -> str | None:
        """The module of an installed class; lines in findings are lines of its file."""
        return self._facts.module

    @property
    def source_file(self) -> str | None:
        """The file of an installed class, where the worker runs."""
        return self._facts.source_file

    @property
    def observation_space(self) -> SpaceSpec:
        """The space that observations are checked against: the contract's, else the environment's own."""
        return self._facts.observation_space

    @property
    def action_space(self) -> SpaceSpec:
        """The space that actions are drawn from. Raises Skip where only the package that defines it can do that, and
        EnvCraftError if the environment has another space than the contract.
        """
        return self._facts.action_space

    @property
    def acts_as_promised(self) -> bool:
        """Whether the environment has the contract's actions."""
        return self._facts.acts_as_promised

    @property
    def renders(self) -> bool:
        """Whether render() must give frames: the contract, the metadata or an optional render() says so."""
        return self._facts.renders

    @property
    def installed_source(self) -> bytes:
        """The content of the file of an installed class; b"" if this machine does not have the same file."""
        return self._facts.installed_source

    def line_of(self, method: str | None = None) -> Line:
        """The line at which the class defines a method, or that of the class if it inherits the method; without a
        method that of the class. If another file defines the class, it is the line that imports or assigns it.
        """
        return self._facts.line_of(method)

    def raised(self, fault: Fault) -> str:
        """The exception of a fault in words; with its file and line if another file than the judged one raises it."""
        return self._facts.raised(fault)

    # Requests

    @property
    def probes(self) -> Probes:
        """The episodes that checks request. Raises Skip where no actions can be drawn."""
        return self._jobs.probes

    @cached_property
    def episodes(self) -> Episodes:
        """The episodes that several checks share."""
        return Episodes(self.cache, self.probes, self.budget)

    @cached_property
    def session(self) -> Session:
        """Many short episodes on one instance."""
        return Session(self.cache, self.probes, self.episodes, self.budget)

    @cached_property
    def searches(self) -> Searches:
        """The searches that checks request."""
        return Searches(self.cache, self.probes, self.episodes, self.budget)

    def prefetch(self, requests: Iterable[Rollout | Search], again: bool = False, alone: bool = False) -> None:
        """Start requests that are nearly sure to come, in this order, and return at once. A request that never comes
        counts nowhere.

        Args:
            requests: rollouts and searches.
            again: :meth:`rerun` will request them.
            alone: nothing runs before the rollout in its process, because it is compared with others bit by bit.
        """
        self.cache.prefetch(requests, again, alone)

    def rollout(self, rollout: Rollout, alone: bool = False) -> Trace:
        """Run a rollout, or give its known trace; `alone` as in :meth:`prefetch`."""
        return self.cache.rollout(rollout, alone)

    def rollouts(self, rollouts: Sequence[Rollout]) -> list[Trace]:
        """Run several rollouts at a time."""
        return self.cache.rollouts(rollouts)

    def rerun(self, rollout: Rollout, alone: bool = True) -> Trace:
        """Run a rollout even if its trace is known, a fresh one in a worker of its own.

        Without `alone` it may follow others in a process: a difference must then be confirmed.
        """
        return self.cache.rerun(rollout, alone)

    def measured(self, rollout: Rollout, seconds: float) -> Trace:
        """Run a rollout for some seconds in a process that ends with it, and measure it. The trace may be shorter than
        the rollout (:meth:`envcraft.judging.rollout_cache.RolloutCache.measured`).
        """
        return self.cache.measured(rollout, seconds)

    # Results

    @property
    def steps(self) -> int:
        """The environment steps that were requested."""
        return self.cache.steps

    def without_reset(self, trace: Trace) -> str:
        """Why the episode of this trace did not begin, for the reason of a check."""
        if trace.ending is Ending.BROKEN:
            return "reset() did not return: see the check sandbox"
        takes = "seed" in self.load().description.get("reset", ("seed",))
        return "reset() does not return an observation and info" if takes else "reset() does not take seed="

    def affords(self, steps: int) -> bool:
        """Whether the budget has so many steps left."""
        return steps <= self.episodes.steps_left

    @property
    def traces(self) -> list[Trace]:
        """Every trace so far, in the order of the requests."""
        return self.cache.traces

    @property
    def fingerprint(self) -> str:
        """The behavioural fingerprint; "" unless its episode was requested and is usable, and all of its
        observations can be compared.
        """
        trace = next((trace for trace in self.traces if trace.watched), None)
        return fingerprint(trace) if trace is not None and trace.usable and not trace.opaque else ""

    # Episodes that several checks share

    @property
    def length(self) -> int:
        """The number of actions of an episode."""
        return self.probes.length

    @property
    def joint_actions(self) -> list[Action]:
        """The joint actions, or a sample where they cannot be counted; the first one does nothing."""
        return self.probes.joint_actions

    def episode_seed(self, number: int) -> int:
        """The seed of the episode with this number; each ``--seed`` has its own."""
        return self.probes.episode_seed(number)

    def random(self, number: int) -> Trace:
        """Random play on the episode seed `number`."""
        return self.rollout(self.probes.random(number))

    def noop(self, number: int = 0, length: int | None = None) -> Trace:
        """An episode of doing nothing. Raises Skip under a contract that names no such action."""
        return self.rollout(self.probes.noop(number, length))

    def rendered(self) -> Trace:
        """Play a short random episode and call render() after each step."""
        return self.rollout(self.probes.random(0).cut(self.budget.inspected // 2).under(Conditions(render=True)))

    def rendered_best(self) -> Trace | None:
        """Play the best episode of a search and call render() after each step; None if there is none worth it."""
        found = self.searches.best()
        if found is None or not (found.positive or self.budget.rotations):
            return None
        return self.rollout(found.rollout.cut(found.steps).under(Conditions(render=True)))

    def inspected(self, rollout: Rollout) -> Rollout:
        """The same episode under conditions that inspect every value and call."""
        options = "options" in self.load().description.get("reset", ("options",))
        return rollout.under(Conditions(reread=True, options=options, closed=True))

    def played(self) -> list[Trace]:
        """The episodes that several checks share: random play, held actions and doing nothing."""
        return self.episodes.all

    def held(self) -> list[Trace]:
        """Each joint action, or as many as the budget allows, held on the first seed."""
        return self.episodes.held

    def act(self, number: int) -> Trace:
        """The privileged policy on the episode seed `number`."""
        return self.rollout(self.probes.policy(number))

    def advised(self, seed: int, actions: list[Action]) -> Trace:
        """An episode of these actions. Its ``chosen`` is what the privileged policy would do in each state."""
        return self.rollout(Rollout(seed, actions, policy=True, max_steps=len(actions)))

    def privileged(self) -> list[Trace]:
        """The actions of the privileged policy on the first seeds, stepped again without it; none without a policy, and
        none where something else than step() fails.
        """
        if self.policy is None:
            return []
        acted = self.rollouts([self.probes.policy(number) for number in range(self.budget.policy)])
        stepped = (
            trace for trace in acted if trace.usable or (trace.fault is not None and trace.fault.phase == "step")
        )
        return [self.without_policy(trace) for trace in stepped]

    def without_policy(self, trace: Trace) -> Trace:
        """Step the privileged policy's actions without it, so without what it may have written to the environment."""
        return self.rollout(
            Rollout(trace.rollout.seed, trace.actions, player="the policy's actions without it"), alone=True
        )


def elapsed(since: float) -> float:
    """Seconds since a reading of ``time.monotonic``, rounded for reports."""
    return round(time.monotonic() - since, 3)
