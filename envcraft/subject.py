"""One environment under test: what its file defines, and the rollouts that the checks ask for, each run once."""

from __future__ import annotations

import ast
import hashlib
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec

from envcraft import actions, spaces
from envcraft.budget import Budget
from envcraft.check import Skip
from envcraft.contract import Contract
from envcraft.errors import UsageError, WorkerLost
from envcraft.rollout import Action, Conditions, Rollout
from envcraft.sandbox import Driver, How, JobEnd, Limits, Worker
from envcraft.trace import Recording, Trace

#: Larger files are not read: no environment of this kind is anywhere near.
MAX_SOURCE = 2 * 1024**2
#: So many hung episodes are waited for, then no more are begun.
_PATIENCE = 3


class Target(msgspec.Struct, frozen=True):
    """A file to judge. `env_class` picks one of several classes."""

    path: str
    source: bytes
    env_class: str | None = None

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.source).hexdigest()


class PolicyFile(msgspec.Struct, frozen=True):
    """A privileged policy to run in the worker."""

    path: str
    source: str


class Loaded(msgspec.Struct, frozen=True):
    """What loading the file in the worker gave. `description` is the worker's own words, `trace` holds a fault."""

    description: dict[str, Any]
    trace: Trace
    end: JobEnd


class Subject:
    """Runs rollouts of one target and remembers every trace.

    Use as a context manager: leaving it ends the workers. Methods that run something raise WorkerLost when the sandbox
    itself fails, which is never the environment's fault.
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
        self._timeouts = 0
        self._workers: dict[int, Worker] = {}
        self._traces: dict[bytes, Trace] = {}
        self._searches: dict[tuple[str, int, int], dict[str, Any]] = {}
        self._loaded: Loaded | None = None

    def __enter__(self) -> Subject:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the workers."""
        while self._workers:
            _, worker = self._workers.popitem()
            worker.close()

    @property
    def text(self) -> str:
        """The source as text. Raises UnicodeDecodeError."""
        return self.target.source.decode("utf-8-sig")

    @property
    def traces(self) -> list[Trace]:
        """Every trace so far, in the order in which they were run."""
        return list(self._traces.values())

    # What the file defines

    def find_modules(self, names: list[str]) -> tuple[list[str], list[str]]:
        """Ask the worker which modules it lacks; with any missing, also which it has."""
        return self._worker(0).find(names)

    def load(self) -> Loaded:
        """Load the file in the worker and construct one instance. The result is kept."""
        if self._loaded is None:
            recording = Recording(Rollout(0, []), None, None)
            end = self._run(self._worker(0), self._job("describe"), recording)
            self._loaded = Loaded(recording.description, recording.trace, end)
            recording.trace.end = end
            self.env_class = recording.description.get("class", self.env_class)
        return self._loaded

    @property
    def observation_space(self) -> spaces.Space:
        """The space that observations are held against: the contract's, else the environment's own."""
        return self.contract.observation or self._own_space("observation_space")

    @property
    def action_space(self) -> spaces.Space:
        return self.contract.action or self._own_space("action_space")

    def line_of(self, method: str) -> int | None:
        """The line at which the class defines a method."""
        line = (self.load().description.get("lines") or {}).get(method)
        return line if isinstance(line, int) else None

    # Episodes

    @property
    def length(self) -> int:
        """How many actions an episode is given."""
        return self.contract.limit or self.budget.steps

    @property
    def choices(self) -> list[Action]:
        """The joint actions, or a sample of them where they cannot be counted; first the one that does nothing."""
        return spaces.enumerate_actions(self.action_space)

    def episode_seed(self, number: int) -> int:
        """The seed of the episode with this number, away from the seeds of another ``--seed``."""
        return self.seed * 100_003 + number

    def rollout(self, rollout: Rollout) -> Trace:
        """Run one rollout, or give its trace again."""
        key = rollout.key()
        if key not in self._traces:
            self._traces[key] = self._record(rollout)
        return self._traces[key]

    def rerun(self, rollout: Rollout) -> Trace:
        """Run one rollout even if its trace is known."""
        return self._record(rollout)

    def random(self, number: int, length: int | None = None) -> Trace:
        """Random play on the episode seed `number`."""
        seed, length = self.episode_seed(number), length or self.length
        return self.rollout(
            Rollout(seed, actions.random_actions(self.action_space, seed, length), player="random play")
        )

    def sticky(self, number: int) -> Trace:
        """Random play with held actions."""
        seed = self.episode_seed(number)
        drawn = actions.sticky_actions(self.action_space, seed, self.length)
        return self.rollout(Rollout(seed, drawn, player="random play with held actions"))

    def hold(self, action: Action, number: int = 0, length: int | None = None) -> Trace:
        """One action throughout."""
        held = actions.held_action(action, length or self.length)
        player = "doing nothing" if action == self.contract.noop else f"holding {action}"
        return self.rollout(Rollout(self.episode_seed(number), held, player=player))

    def noop(self, number: int = 0, length: int | None = None) -> Trace:
        """Doing nothing. Raises Skip under a contract that knows no such action."""
        if self.contract.noop is None:
            raise Skip(f"the contract {self.contract.name} names no action that does nothing")
        return self.hold(self.contract.noop, number, length)

    def rotation(self, offset: int) -> Trace:
        """Every joint action in a shuffled order, begun at `offset`."""
        choices = self.choices
        number, offset = divmod(offset, len(choices))
        seed = self.episode_seed(number)
        order = actions.rotation(choices, offset, seed, self.length)
        return self.rollout(Rollout(seed, order, player="every action in turn"))

    def played(self) -> list[Trace]:
        """The episodes that several checks share: random, sticky, held and doing nothing. Run once."""
        found = [self.random(number) for number in range(self.budget.random)]
        found += [self.sticky(number) for number in range(self.budget.sticky)]
        found += self.held()
        if self.contract.noop is not None:
            found += [self.noop(number) for number in range(1, 3)]
        return found

    def held(self) -> list[Trace]:
        """Each joint action (as many as the budget allows) held on the first seed."""
        choices = self.choices
        stride = max(len(choices) // self.budget.held, 1)
        return [self.hold(action) for action in choices[::stride]]

    def act(self, number: int) -> Trace:
        """The privileged policy on the episode seed `number`."""
        rollout = Rollout(self.episode_seed(number), [], player="the policy", policy=True, max_steps=self.length)
        return self.rollout(rollout)

    # Searches in the worker: advice, to be confirmed by a rollout

    def explore(self, number: int = 0) -> dict[str, Any]:
        """Search from the episode seed `number` for crashes and wins (see the worker's ``explore``)."""
        return self._search("explore", number, self.budget.explore[0])

    def explored(self) -> list[Trace]:
        """The wins, or else the best episodes, that exploration found, stepped: some things only show there."""
        found = []
        for number in range(self.budget.explore[1]):
            told = self.explore(number)
            if chosen := told.get("win") or told.get("best"):
                found.append(self.scripted(number, chosen, "exploration"))
        return found

    def exhaust(self, number: int = 0) -> dict[str, Any]:
        """Search through all states that can be reached."""
        return self._search("exhaust", number, self.budget.exhaust)

    def greedy(self, number: int = 0) -> dict[str, Any]:
        """Five moves, each with the highest immediate reward."""
        return self._search("greedy", number, 10_000)

    def sweep(self, path: list[Action], seed: int) -> dict[str, Any]:
        """Try actions on copies of the states along a path."""
        return self._search("sweep", seed - self.episode_seed(0), self.budget.sweep, path)

    def scripted(self, number: int, chosen: Sequence[Action], player: str) -> Trace:
        """An action list that a search found, stepped for real."""
        return self.rollout(Rollout(self.episode_seed(number), list(chosen), player=player))

    def _search(self, kind: str, number: int, budget: int, path: list[Action] | None = None) -> dict[str, Any]:
        key = (kind, number, hash(str(path)))
        if key not in self._searches:
            seed = self.episode_seed(number)
            job = self._job("search", search=kind, seed=seed, actions=self.choices)
            job |= {"path": path or [], "max_steps": budget, "limit": self.length}
            recording = Recording(Rollout(seed, []), None, None)
            self._run(self._worker(0), job, recording)
            self._searches[key] = recording.trace.result or {}
            self.steps += int(self._searches[key].get("steps", 0))
        return self._searches[key]

    def _own_space(self, name: str) -> spaces.Space:
        space = self.load().description.get(name)
        if not isinstance(space, dict) or "type" not in space:
            raise Skip(f"the environment could not be constructed, so its {name} is not known")
        return space

    def _record(self, rollout: Rollout) -> Trace:
        if self._timeouts >= _PATIENCE:
            raise Skip(f"{self._timeouts} episodes hung; the check sandbox tells where")
        recording = Recording(rollout, self.observation_space, self.action_space)
        job = self._job(
            "rollout",
            seed=rollout.seed,
            actions=rollout.actions,
            max_steps=rollout.max_steps,
            conditions=rollout.conditions.to_json(),
        )
        if rollout.conditions.options:
            job["options"] = {}
        if rollout.policy and self.policy is not None:
            job["policy"] = {"source": self.policy.source, "filename": "<envcraft_policy>"}
        end = self._under(rollout.conditions, job, recording)
        self._timeouts += end.how is How.TIMEOUT
        if end.how is How.DIED or (end.how is How.TIMEOUT and self._timeouts == 1):
            # Batches hide how far it came: the same episode once more, every step sent at once, tells.
            again = Recording(rollout, self.observation_space, self.action_space)
            end_again = self._under(rollout.conditions, {**job, "every_step": True}, again)
            if end_again.how is end.how:
                recording, end = again, end_again
        recording.trace.end = end
        self.steps += recording.trace.steps
        return recording.trace

    def _under(self, conditions: Conditions, job: dict[str, Any], recording: Recording) -> JobEnd:
        if not conditions.fresh:
            return self._run(self._worker(conditions.hash_seed), job, recording)
        worker = self._launch(conditions.hash_seed)
        try:
            return self._run(worker, job, recording)
        finally:
            worker.close()

    def _run(self, worker: Worker, job: dict[str, Any], recording: Recording) -> JobEnd:
        try:
            return worker.run(job, recording, self.limits)
        except WorkerLost:
            self.close()
            raise

    def _worker(self, hash_seed: int) -> Worker:
        if hash_seed not in self._workers:
            self._workers[hash_seed] = self._launch(hash_seed)
        return self._workers[hash_seed]

    def _launch(self, hash_seed: int) -> Worker:
        worker = self.driver.launch(hash_seed=hash_seed, limits=self.limits)
        libraries = sorted(set(imported(self.target.source)) & set(self.contract.libraries or ()))
        if libraries:
            worker.preload(libraries)
        return worker

    def _job(self, kind: str, **fields: Any) -> dict[str, Any]:
        return {
            "kind": kind,
            "filename": Path(self.target.path).name,
            "source": self.text,
            "class": self.env_class,
            "contract": self.contract.for_worker(),
            **fields,
        }


def imported(source: bytes) -> Iterable[str]:
    """The top-level modules that a source imports anywhere; none where it does not parse."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]


def read_target(path: str, env_class: str | None = None) -> Target:
    """Read a file to judge. Raises UsageError when it cannot be read."""
    try:
        with open(path, "rb") as stream:
            return Target(path, stream.read(MAX_SOURCE + 1), env_class)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from None


def read_policy(path: str) -> PolicyFile:
    """Read a privileged policy. Raises UsageError when it cannot be read or is no text."""
    try:
        return PolicyFile(path, Path(path).read_text("utf-8"))
    except OSError as error:
        raise UsageError(f"the policy {path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"the policy {path} is not Python text") from None


def elapsed(since: float) -> float:
    """Seconds since a reading of ``time.monotonic``, rounded for reports."""
    return round(time.monotonic() - since, 3)
