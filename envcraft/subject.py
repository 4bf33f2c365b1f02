"""One environment under test: what its file defines, and the rollouts that the checks ask for, each run once."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import TracebackType
from typing import Any, TypeVar

import msgspec

from envcraft import spaces
from envcraft.budget import Budget
from envcraft.check import Skip
from envcraft.contract import Contract
from envcraft.description import Description, Outcome
from envcraft.errors import EnvCraftError, WorkerLost
from envcraft.lanes import Lanes, Place, Task
from envcraft.players import Players
from envcraft.recording import Recording
from envcraft.rollout import Action, Conditions, Rollout
from envcraft.sandbox import Driver, How, Isolation, JobEnd, Limits, Player, Worker
from envcraft.searches import Search, Searches
from envcraft.similarity.behavioural import STEPS, fingerprint
from envcraft.target import Kind, PolicyFile, Target, imported
from envcraft.trace import Trace

#: What a search has found by this share of a job's time is all that it finds, so that slow steps cost no more.
_SEARCH_SHARE = 0.2
#: So many hung jobs are waited for, then no more are begun.
_PATIENCE = 3
#: So many jobs whose worker was gone are run again on another one: what ended it may have been meant for its neighbour.
_LOST = 2
#: Modules that keep nothing for a process but what a worker puts back: all of a file's, if its episodes share one.
_TIDY = {
    "__future__", "abc", "bisect", "collections", "colorsys", "copy", "dataclasses", "enum", "fractions", "functools",
    "gymnasium", "heapq", "itertools", "math", "numpy", "operator", "queue", "random", "re", "statistics", "string",
    "textwrap", "time", "types", "typing",
}  # fmt: skip

_T = TypeVar("_T")


class Loaded(msgspec.Struct, frozen=True):
    """What loading the file in the worker gave. `description` is the worker's own words, `trace` holds a fault."""

    description: Description
    trace: Trace
    end: JobEnd


@dataclass(frozen=True)
class Begun:
    """A rollout or a search that was handed to the lanes. Nothing of it counts before a check asks for it."""

    recording: Recording
    task: Task


class Subject:
    """Runs rollouts of one target, up to `lanes` at a time, and remembers every trace.

    A rollout counts when a check asks for it, whenever it ran: what the checks see never depends on which job ends
    first, nor on the number of lanes.

    Use as a context manager: leaving it ends the workers. Methods that run something raise WorkerLost when the sandbox
    itself fails, which is never the environment's fault.

    Attributes:
        steps: environment steps that were asked for.
        seconds: what the jobs that were asked for took, all together.
        stepped: called with `steps` whenever they have grown, which is once an episode or search.
        about: what the first worker said of itself (:attr:`envcraft.sandbox.Worker.about`), {} before there is one.
    """

    def __init__(
        self,
        target: Target,
        contract: Contract,
        driver: Driver,
        budget: Budget,
        seed: int = 0,
        policy: PolicyFile | None = None,
        limits: Limits | None = None,
        lanes: int = 1,
    ) -> None:
        self.target = target
        self.contract = contract
        self.driver = driver
        self.budget = budget
        self.seed = seed
        self.policy = policy
        self.limits = limits or Limits()
        self.env_class = target.env_class
        self.steps = 0
        self.seconds = 0.0
        self.stepped: Callable[[int], None] | None = None
        self.about: dict[str, Any] = {}
        self._timeouts = 0
        self._lost = 0
        self._tidy = not target.installed and set(imported(target.source)) <= _TIDY
        self._lanes = Lanes(self._launch, lanes)
        self._ahead: dict[tuple[bytes, bool], Begun] = {}
        self._compared: set[bytes] = set()
        #: Those before which others may have run in their process.
        self._followed: set[bytes] = set()
        self._prepared: weakref.WeakSet[Worker] = weakref.WeakSet()
        self._traces: dict[bytes, Trace] = {}
        self._searches: dict[bytes, Outcome] = {}
        self._loaded: Loaded | None = None

    def __enter__(self) -> Subject:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the workers."""
        self._lanes.close()

    @property
    def text(self) -> str:
        """The source as text. Raises UnicodeDecodeError."""
        return self.target.text

    @property
    def source_sha256(self) -> str:
        """The digest of the file that the class comes from: for what is installed, as the worker says."""
        told = self._loaded.description.get("sha256") if self._loaded is not None else None
        return told if told and self.target.kind is not Kind.SOURCE else self.target.sha256

    @property
    def module(self) -> str | None:
        """The module of an installed class, whose file has the lines that findings name."""
        told = self._loaded.description.get("module") if self._loaded is not None else None
        return told if told and self.target.kind is not Kind.SOURCE else None

    @property
    def traces(self) -> list[Trace]:
        """Every trace so far, in the order in which they were asked for."""
        return list(self._traces.values())

    @property
    def fingerprint(self) -> str:
        """What it did in the episode by which environments are told apart; "" unless a check asked for it, it came
        through, and all of its observations could be looked into.
        """
        trace = next((trace for trace in self._traces.values() if trace.watched), None)
        return fingerprint(trace) if trace is not None and trace.usable and not trace.opaque else ""

    # What the file defines

    def find_modules(self, names: list[str]) -> tuple[list[str], list[str]]:
        """Ask the worker which modules it lacks; with any missing, also which it has."""

        def attempt() -> tuple[list[str], list[str]]:
            task = self._lanes.submit(Place(), lambda worker: worker.find(names))
            found: tuple[list[str], list[str]] = self._lanes.wait(task)
            return found

        return self._persist(attempt)

    def load(self) -> Loaded:
        """Load the file in the worker and construct one instance. The result is kept."""
        if self._loaded is None:
            self._loaded = self._persist(self._describe)
            self._prepared.clear()
            self.env_class = self._loaded.description.get("class", self.env_class)
        return self._loaded

    def _describe(self) -> Loaded:
        recording = Recording(Rollout(0, []), None, None)
        end = recording.trace.end = self._end(
            self._submit(Place(), self._job("describe", series=self._tidy), recording)
        )
        return Loaded(recording.description, recording.trace, end)

    @property
    def observation_space(self) -> spaces.Space:
        """The space that observations are held against: the contract's, else the environment's own."""
        return self.contract.observation or self._own_space("observation_space")

    @property
    def action_space(self) -> spaces.Space:
        """The space that actions are drawn from. Raises Skip where it is of a kind that only its package knows."""
        space = self.contract.action or self._own_space("action_space")
        if not spaces.known(space):
            raise Skip(f"no actions can be drawn from the action space, {spaces.describe(space)}")
        return space

    @property
    def renders(self) -> bool:
        """Whether render() is to give frames: the contract wants it, or the environment says so."""
        return self.contract.render or "rgb_array" in self.load().description.get("render_modes", ())

    def line_of(self, method: str) -> int | None:
        """The line at which the class defines a method."""
        return self.load().description.get("lines", {}).get(method)

    # Episodes

    @cached_property
    def players(self) -> Players:
        """The episodes to ask for."""
        return Players(self.contract, self.budget, self.seed, self.action_space)

    @property
    def length(self) -> int:
        """How many actions an episode is given."""
        return self.players.length

    @property
    def choices(self) -> list[Action]:
        """The joint actions, or a sample of them where they cannot be counted; first the one that does nothing."""
        return self.players.choices

    def episode_seed(self, number: int) -> int:
        """The seed of the episode with this number, away from the seeds of another ``--seed``."""
        return self.players.episode_seed(number)

    def foresee(self, requests: Iterable[Rollout | Search], again: bool = False, alone: bool = False) -> None:
        """Begin what is nearly sure to be asked for, in this order, and come back at once.

        With `again` it is :meth:`rerun` that will ask. What is never asked for counts nowhere. Jobs may follow one
        another in one process; nothing has run before in that of one that is `alone`, to be held against others bit by
        bit.
        """
        if self._refusal:
            return
        for request in requests:
            key = (request.key(), again)
            if alone:
                self._compared.add(key[0])
            known = not again and (key[0] in self._traces or key[0] in self._searches)
            if alone and key[0] in self._followed:
                known = False
            if not known and key not in self._ahead:
                self._ahead[key] = self._begin(request, again, alone=again)

    def forget(self) -> None:
        """Begin nothing more of what was foreseen."""
        self._ahead = {key: begun for key, begun in self._ahead.items() if not self._lanes.drop(begun.task)}

    def drop(self) -> None:
        """Let go of the traces that are known: whoever plays episodes by the thousand asks for none a second time."""
        self._traces.clear()

    def rollout(self, rollout: Rollout, alone: bool = False) -> Trace:
        """Run one rollout, or give its trace again; `alone` as in :meth:`foresee`."""
        key = rollout.key()
        if alone:
            self._compared.add(key)
            if key in self._followed:
                self._followed.remove(key)
                self._traces.pop(key, None)
        if key not in self._traces:
            self._traces[key] = self._record(rollout)
        return self._traces[key]

    def rollouts(self, rollouts: Sequence[Rollout]) -> list[Trace]:
        """Run several rollouts side by side."""
        self.foresee(rollouts)
        return [self.rollout(rollout) for rollout in rollouts]

    def rerun(self, rollout: Rollout, alone: bool = True) -> Trace:
        """Run one rollout even if its trace is known; a fresh one in a worker of its own. One that is not `alone` may
        follow others in a process: what differs then has to be seen again.
        """
        return self._record(rollout, again=True, alone=alone)

    def measured(self, rollout: Rollout) -> Trace:
        """Run one rollout in a process that ends with it: the end of its trace tells what that process has spent, and
        at how many steps it waited.
        """
        if refusal := self._refusal:
            raise Skip(refusal)
        trace = self._persist(lambda: self._result(self._begin(rollout, again=True, measured=True)))
        self._count(trace.steps)
        return trace

    def random(self, number: int) -> Trace:
        """Random play on the episode seed `number`."""
        return self.rollout(self.players.random(number))

    def noop(self, number: int = 0, length: int | None = None) -> Trace:
        """Doing nothing. Raises Skip under a contract that knows no such action."""
        return self.rollout(self.players.noop(number, length))

    def played(self) -> list[Trace]:
        """The episodes that several checks share: random, sticky, held and doing nothing. Run once."""
        return self.rollouts(self.players.all)

    def held(self) -> list[Trace]:
        """Each joint action (as many as the budget allows) held on the first seed."""
        return self.rollouts(self.players.held)

    def act(self, number: int) -> Trace:
        """The privileged policy on the episode seed `number`."""
        return self.rollout(self.players.policy(number))

    def privileged(self) -> list[Trace]:
        """What the privileged policy, if there is one, does on the first seeds, stepped again without it."""
        if self.policy is None:
            return []
        acted = self.rollouts([self.players.policy(number) for number in range(3)])
        return [self.without_policy(trace) for trace in acted if trace.usable]

    def without_policy(self, trace: Trace) -> Trace:
        """The privileged policy's actions without it: what it wrote to the environment, if anything, is missing."""
        return self.rollout(
            Rollout(trace.rollout.seed, trace.actions, player="the policy's actions without it"), alone=True
        )

    # Episodes whose actions are chosen while they are played

    def begin(self, rollout: Rollout, player: Player, kind: type[Recording] = Recording) -> Begun:
        """Begin an episode whose actions `player` is asked for, and come back at once."""
        return self._begin(rollout, player=player, kind=kind)

    def finish(self, begun: Begun) -> Trace:
        """Wait for the end of such an episode; its trace is that of the same actions from a list, and is kept."""
        trace = self._result(begun)
        trace.rollout = msgspec.structs.replace(trace.rollout, actions=trace.actions, asked=False, max_steps=0)
        self._count(trace.steps)
        self._traces[trace.rollout.key()] = trace
        return trace

    def leave(self, begun: Begun) -> None:
        """Count the steps and the time of such an episode, once it is over, and keep no trace of it."""
        self._count(begun.recording.trace.steps)
        if begun.task.future.exception() is None:
            self.seconds += begun.task.future.result().seconds

    # Searches in the worker

    @cached_property
    def searches(self) -> Searches:
        """The searches to ask for."""
        return Searches(self)

    def search(self, search: Search) -> Outcome:
        """Run one search, or give its outcome again."""
        key = search.key()
        if key not in self._searches:
            trace = self._ask(search)
            self._searches[key] = trace.result or {}
            self._count(min(max(self._searches[key].get("steps", 0), 0), search.budget))
        return self._searches[key]

    @property
    def overrun(self) -> bool:
        """Whether the subject's jobs have taken all the time that they may take together."""
        return self.seconds > self.limits.total * self.budget.patience

    def _own_space(self, name: str) -> spaces.Space:
        space: spaces.Space | None = self.load().description.get(name)  # type: ignore[assignment]
        if space is None:
            raise Skip(f"the environment could not be constructed, so its {name} is not known")
        return space

    def _record(self, rollout: Rollout, again: bool = False, alone: bool = False) -> Trace:
        trace = self._ask(rollout, again, alone)
        if trace.end is not None and (
            trace.end.how is How.DIED or (trace.end.how is How.TIMEOUT and self._timeouts == 1)
        ):
            # Batches hide how far it came: the same episode once more, every step sent at once, tells.
            slow = self._persist(lambda: self._result(self._begin(rollout, again, every_step=True)))
            hung = trace.end.how is How.TIMEOUT
            if slow.end is not None and slow.end.how is trace.end.how:
                trace = slow
            elif slow.end is not None and hung and slow.end.how is How.DONE:
                # A deadline that is kept the second time was missed by the machine, not by the program.
                trace = slow
                self._timeouts -= 1
        self._count(trace.steps)
        return trace

    def _count(self, steps: int) -> None:
        self.steps += steps
        if self.stepped is not None:
            self.stepped(self.steps)

    @property
    def _refusal(self) -> str:
        """Why nothing more is run, if so."""
        if self._timeouts >= _PATIENCE:
            return f"{self._timeouts} episodes or searches hung: see sandbox, or difficulty for a policy"
        return f"its episodes took {self.seconds:.0f} s together; the check sandbox tells more" if self.overrun else ""

    def _ask(self, request: Rollout | Search, again: bool = False, alone: bool = False) -> Trace:
        """Wait for what a check asks for. Whatever depends on the order of asking is done here. Raises Skip."""
        if refusal := self._refusal:
            raise Skip(refusal)
        key = (request.key(), again)

        def attempt() -> Trace:
            begun = self._ahead.pop(key, None) or self._begin(request, again, alone=alone)
            return self._result(begun)

        trace = self._persist(attempt)
        if isinstance(request, Rollout):
            # Foreseen it may have had another name.
            trace.rollout = request
        self._timeouts += trace.end is not None and trace.end.how is How.TIMEOUT
        if self._refusal:
            self.forget()
        return trace

    def _persist(self, attempt: Callable[[], _T]) -> _T:
        """What an attempt gives, or where its worker was lost, what another one does. Raises EnvCraftError."""
        try:
            return attempt()
        except WorkerLost:
            self._lost += 1
            if self._lost > _LOST:
                raise
        return attempt()

    def _result(self, begun: Begun) -> Trace:
        begun.recording.trace.end = self._end(begun)
        return begun.recording.trace

    def _end(self, begun: Begun) -> JobEnd:
        try:
            end: JobEnd = self._lanes.wait(begun.task)
        except EnvCraftError:
            # The sandbox failed: what was foreseen would only fail again.
            self.forget()
            raise
        self.seconds += end.seconds
        return end

    def _begin(
        self,
        request: Rollout | Search,
        again: bool = False,
        every_step: bool = False,
        player: Player | None = None,
        kind: type[Recording] = Recording,
        alone: bool = False,
        measured: bool = False,
    ) -> Begun:
        series = not (every_step or measured) and self._may_share(request)
        if isinstance(request, Search):
            job = self._job("search", search=request.kind, seed=request.seed, actions=self.choices)
            job |= {"path": request.path, "max_steps": request.budget, "limit": self.length}
            job |= {"seconds": self.limits.job * _SEARCH_SHARE, "series": series}
            asked = Rollout(request.seed, [], max_steps=self.length)
            return self._submit(Place(), job, Recording(asked, None, self.action_space))
        conditions = request.conditions
        job = self._job(
            "rollout",
            seed=request.seed,
            actions=request.actions,
            max_steps=request.max_steps,
            conditions=conditions.to_json(),
        )
        if conditions.options:
            job["options"] = {}
        if request.policy and self.policy is not None:
            job["policy"] = {"source": self.policy.source, "filename": "<envcraft_policy>"}
        if every_step:
            job["every_step"] = True
        if measured:
            job["measured"] = True
        if request.asked:
            job["asked"] = True
        if series:
            job["series"] = True
            # Held against others bit by bit: nothing has run in its process before.
            job["first"] = alone or (not again and request.key() in self._compared | self._probes)
            if not again and not job["first"]:
                self._followed.add(request.key())
        if conditions.fresh or conditions.hash_seed:
            own = conditions.fresh and again
            place = Place(conditions.hash_seed, apart=not own, own=own)
        else:
            # Conditions are compared with the plain run: in its worker nothing else differs.
            place = Place(home=request.under(Conditions()).key())
        recording = kind(
            request,
            self.observation_space,
            self.action_space,
            exact=self.contract.observation is not None,
            success=self.contract.success,
            watch=self._watches(request),
        )
        return self._submit(place, job, recording, player)

    def _may_share(self, request: Rollout | Search) -> bool:
        """Whether a job may run in a process with others, since nothing has gone wrong with any so far; not those whose
        conditions outlast them, nor the search that is a proof.
        """
        if isinstance(request, Search):
            return self._tidy and request.kind != "exhaust"
        return self._tidy and not request.live and request.conditions.passing

    @cached_property
    def _probes(self) -> set[bytes]:
        """Those on which determinism is probed and that are played no further: the others are played again for it."""
        length = self.budget.probes[1]
        return {rollout.key() for rollout in self.players.probes if len(rollout.actions) <= length}

    @cached_property
    def _watched(self) -> list[Action]:
        """How the episode of the fingerprint begins: as far as it goes, the same whatever the budget."""
        return self.players.sticky(0).actions[:STEPS]

    def _watches(self, request: Rollout) -> bool:
        plain = not request.live and request.seed == self.episode_seed(0) and request.conditions == Conditions()
        return plain and request.actions[:STEPS] == self._watched

    def _submit(self, place: Place, job: dict[str, Any], recording: Recording, player: Player | None = None) -> Begun:
        return Begun(recording, self._lanes.submit(place, lambda worker: self._run(worker, job, recording, player)))

    def _run(self, worker: Worker, job: dict[str, Any], recording: Recording, player: Player | None) -> JobEnd:
        if worker not in self._prepared:
            self._prepared.add(worker)
            # Not before a job has shown that they can be imported; and where the fork server has no isolation of its
            # own, jobs import them one by one.
            if self._modules and self.driver.isolation is not Isolation.PROCESS:
                worker.preload(self._modules)
        end = worker.run(job, recording, self.limits, player)
        wrong = end.how is not How.DONE or recording.trace.fault is not None
        if not wrong or not job.get("series"):
            return end
        if not end.before and end.phase != "close":
            return end
        # What goes wrong after other episodes, or in clearing up for them, may be their doing.
        self._tidy = False
        recording.begin()
        alone = worker.run({**job, "series": False}, recording, self.limits)
        return msgspec.structs.replace(alone, seconds=end.seconds + alone.seconds)

    @property
    def _modules(self) -> list[str]:
        """What an installed environment imports, as the worker says."""
        if self._loaded is None:
            return []
        told = self._loaded.description
        # A process with threads must not be forked.
        return told.get("modules", []) if told.get("effects", {}).get("threads") == 0 else []

    def _launch(self, place: Place) -> Worker:
        launch = self.driver.launch if place.fresh else self.driver.sibling
        worker = launch(hash_seed=place.hash_seed, limits=self.limits)
        self.about = self.about or worker.about
        libraries = sorted(set(imported(self.target.source)) & set(self.contract.libraries or ()))
        if libraries:
            try:
                worker.preload(libraries)
            except BaseException:
                worker.close()
                raise
        return worker

    def _job(self, kind: str, **fields: Any) -> dict[str, Any]:
        return {
            "kind": kind,
            "target": msgspec.structs.replace(self.target, env_class=self.env_class).for_worker(),
            "contract": self.contract.for_worker(),
            **fields,
        }


def elapsed(since: float) -> float:
    """Seconds since a reading of ``time.monotonic``, rounded for reports."""
    return round(time.monotonic() - since, 3)
