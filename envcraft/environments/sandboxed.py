"""A Gymnasium environment whose code runs in the sandbox. An episode is a job that requests its actions one by one."""

from __future__ import annotations

import contextlib
import json
import math
import queue
from typing import Any

import gymnasium
import msgspec
from envcraft_protocol.spaces import encode_action
from gymnasium.error import ResetNeeded

from envcraft.errors import EnvironmentFailed, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Driver, Step
from envcraft.judging.interactive import InteractiveEpisode
from envcraft.judging.subject import Subject
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model import phases
from envcraft.model.contract import Contract
from envcraft.model.job import ExitReason
from envcraft.model.rollout import Conditions
from envcraft.model.target import Project, Target
from envcraft.model.trace import Trace
from envcraft.spaces.gymnasium import to_gymnasium
from envcraft.spaces.spec import read_space

#: No limit in practice, because only the environment ends its episodes.
_STEPS = 10**12
#: Types of rewards and flags that a trace accepts.
_NUMBERS = ("bool", "numpy.bool", "int", "numpy integer", "float", "numpy floating")
_MAX_SEED = 2**31 - 1


class _Shown(TraceBuilder):
    """A recorder that keeps the values of the last call."""

    observation: Any = None
    frame: Any = None
    info: bytes = b""

    def reset(self, step: Step) -> None:
        super().reset(step)
        self._take(step)

    def step(self, step: Step) -> None:
        super().step(step)
        self._take(step)

    def render(self, layout: int, data: memoryview, digest: bytes = b"") -> None:
        super().render(layout, data, digest)
        self.frame = self._decode(layout, data, digest)

    def _take(self, step: Step) -> None:
        # The caller may write to it.
        self.observation = self._decode(step.layout, memoryview(bytearray(step.data)), step.digest)
        self.info = step.info


class _Episode(InteractiveEpisode[_Shown]):
    """An episode that an agent plays step by step."""

    def __init__(self, subject: Subject, seed: int, conditions: Conditions) -> None:
        self._turns: queue.SimpleQueue[None] = queue.SimpleQueue()
        super().__init__(subject, seed, conditions, "an agent", _STEPS, _Shown)
        self._pending.task.future.add_done_callback(lambda _: self._turns.put(None))

    def wait(self) -> None:
        """Wait until the job requests an action or ends."""
        self._turns.get()

    def action_requested(self) -> None:
        self._turns.put(None)


class SubjectEnv(gymnasium.Env[Any, Any]):
    """A subject that is stepped in its worker, one episode at a time.

    Every episode runs on a new instance in a new process, and occupies one lane of the subject until it ends.

    Observations, rewards, flags and info are those of the environment under its contract's adapter. Of the info, only
    what JSON can represent is kept. ``reset()`` without a seed draws one. If the code ends or damages its process, the
    episode ends with EnvironmentFailed, and the next reset starts a new one.

    Attributes:
        failed: the trace of the last episode that failed.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}
    failed: Trace | None = None

    def __init__(self, name: str, subject: Subject, render_mode: str | None = None) -> None:
        """Construct one instance to learn the spaces.

        Args:
            name: names the environment in messages.
            subject: the environment.
            render_mode: None or "rgb_array".

        Raises:
            UsageError: a space cannot be sent over the trust boundary.
            EnvironmentFailed: the class cannot be constructed.
        """
        self._name, self._subject = name, subject
        self._episode: _Episode | None = None
        self.render_mode = render_mode
        self._conditions = Conditions(render=render_mode is not None)
        self._learn(subject.contract)

    def _learn(self, contract: Contract) -> None:
        loaded = self._subject.load()
        description = loaded.description
        if loaded.trace.fault is not None or loaded.end.reason is not ExitReason.DONE:
            raise EnvironmentFailed(f"{self._name} cannot be constructed: {loaded.trace.fault or loaded.end.detail}")
        if "observation_space" not in description or "action_space" not in description:
            raise EnvironmentFailed(
                f"{self._name} has no environment class, or several; run `envcraft validate` for details"
            )
        observation = contract.observation or description["observation_space"]
        action = contract.action or description["action_space"]
        self.observation_space = to_gymnasium(read_space(observation), f"the observation space of {self._name}")
        self.action_space = to_gymnasium(read_space(action), f"the action space of {self._name}")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: of the episode. None draws one.
            options: must be empty, because the sandbox does not pass them on.

        Returns:
            The first observation and its info.

        Raises:
            UsageError: `options` is not empty.
            EnvironmentFailed: the environment raised, or ended its process.
        """
        if options:
            raise UsageError(f"{self._name} runs in a sandbox, where reset() takes no options")
        super().reset(seed=seed)
        self._stop()
        if seed is None:
            seed = int(self.np_random.integers(_MAX_SEED))
        self._episode = _Episode(self._subject, seed, self._conditions)
        shown = self._wait(self._episode)
        if not shown.trace.observations:
            raise self._failure(self._episode)
        return shown.observation, _info(shown)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take a step.

        Args:
            action: an element of `action_space`.

        Returns:
            The observation, the reward, terminated, truncated and the info.

        Raises:
            ValueError: the action is outside the space.
            ResetNeeded: no episode is running.
            EnvironmentFailed: the environment raised, ended its process or returned a value of the wrong type.
        """
        episode = self._episode
        if episode is None or (episode.over and episode.shown.trace.ended):
            raise ResetNeeded(f"{self._name}: call reset() first, and again after an episode's end")
        if episode.over:
            raise self._failure(episode)
        steps = episode.shown.trace.steps
        episode.give(encode_action(self.action_space, action))
        shown = self._wait(episode)
        trace = shown.trace
        if trace.steps == steps:
            raise self._failure(episode)
        self._refuse(trace)
        return shown.observation, trace.rewards[-1], trace.terminated[-1], trace.truncated[-1], _info(shown)

    def render(self) -> Any:
        """Return the frame of render() after the last call, or None without ``render_mode="rgb_array"``."""
        return self._episode.shown.frame if self._episode is not None else None

    def finish(self) -> Trace:
        """End the episode here, and return its trace.

        Raises:
            ResetNeeded: no episode is running.
            WorkerLost: the sandbox failed.
        """
        episode, self._episode = self._episode, None
        if episode is None:
            raise ResetNeeded(f"{self._name}: call reset() first")
        with contextlib.closing(episode):
            episode.stop()
            return episode.finish()

    def close(self) -> None:
        """End the episode. A second call does nothing."""
        self._stop()

    def _stop(self) -> None:
        if self._episode is not None:
            episode, self._episode = self._episode, None
            episode.leave()

    def _wait(self, episode: _Episode) -> _Shown:
        """Wait for the result of a call. Raises EnvironmentFailed if its observation has the wrong type."""
        episode.wait()
        wrong = [problem for problem in episode.shown.trace.problems if problem.kind == "type"]
        if wrong:
            self.failed = episode.shown.trace
            raise EnvironmentFailed(f"{self._name}: at step {wrong[0].step} {wrong[0].words}")
        return episode.shown

    def _refuse(self, trace: Trace) -> None:
        """Raise EnvironmentFailed if the last reward or flag is not a number, for which a trace has a substitute."""
        types = {"reward": trace.reward_types[-1], "terminated": trace.flag_types[-1][0]}
        types["truncated"] = trace.flag_types[-1][1]
        for name, kind in types.items():
            if kind not in _NUMBERS:
                self.failed = trace
                raise EnvironmentFailed(f"{self._name}: at step {trace.steps} {name} is of type {kind}")

    def _failure(self, episode: _Episode) -> EnvironmentFailed:
        """Return why the job ended. Raises WorkerLost if the sandbox failed."""
        end, trace = episode.end(), episode.shown.trace
        self.failed, trace.end = trace, end
        if trace.fault is not None:
            at = phases.in_words(trace.fault.phase, trace.fault.step)
            return EnvironmentFailed(f"{self._name} failed in {at}: {trace.fault}")
        words = end.detail or end.reason.value
        return EnvironmentFailed(
            f"{self._name} ended in the sandbox in {phases.in_words(end.phase)} ({end.reason.value}: {words})"
        )


class SandboxedEnv(SubjectEnv):
    """A :class:`SubjectEnv` that owns its worker and ends it in ``close()``."""

    def __init__(self, name: str, target: Target, contract: Contract, driver: Driver, render_mode: str | None) -> None:
        """Start a worker and construct one instance.

        Args:
            name: names the environment in messages.
            target: the source.
            contract: what it promises.
            driver: the sandbox; ``close()`` closes it.
            render_mode: None or "rgb_array".

        Raises:
            UsageError: a space cannot be sent over the trust boundary.
            SandboxUnavailable: the driver cannot start a worker.
            EnvironmentFailed: the class cannot be constructed.
        """
        self._driver = driver
        subject = Subject(target, contract, WorkerPool(driver).lease(), BUDGETS["quick"], seconds=math.inf)
        with contextlib.ExitStack() as stack:
            stack.callback(driver.close)
            stack.callback(subject.close)
            super().__init__(name, subject, render_mode)
            stack.pop_all()

    def close(self) -> None:
        """End the episode and the worker. A second call does nothing."""
        self._stop()
        self._subject.close()
        self._driver.close()


def _info(shown: _Shown) -> dict[str, Any]:
    try:
        value = json.loads(shown.info or b"{}")
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}


def open_sandboxed(
    name: str,
    source: bytes,
    env_class: str | None,
    contract: Contract,
    sandbox: str,
    runtime: str | None,
    kwargs: dict[str, Any],
    project: Project | None = None,
) -> SandboxedEnv:
    """Start a sandbox and the environment in it.

    Args:
        name: names the environment in messages.
        source: the Python file.
        env_class: the class in the file; None if there is only one.
        contract: what the environment promises.
        sandbox: the name of a driver, or "auto".
        runtime: the container runtime of the driver docker. None chooses one.
        kwargs: the arguments of the constructor, as JSON values.
        project: the files of its project that the file needs.

    Raises:
        UsageError: an argument is invalid.
        SandboxUnavailable: the driver cannot start a worker.
        EnvironmentFailed: the class cannot be constructed.
    """
    from envcraft.judging.selection import driver_named

    render_mode = kwargs.get("render_mode")
    if render_mode not in (None, "rgb_array"):
        raise UsageError(f"{name} runs in a sandbox, where render_mode can only be 'rgb_array', not {render_mode!r}")
    given = {key: value for key, value in kwargs.items() if key != "render_mode"}
    try:
        msgspec.json.encode(given)
    except TypeError as error:
        raise UsageError(f"{name} runs in a sandbox, and its arguments must be JSON: {error}") from None
    target = Target(name, source, env_class, kwargs=given, project=project)
    return SandboxedEnv(name, target, contract, driver_named(sandbox, runtime=runtime), render_mode)
