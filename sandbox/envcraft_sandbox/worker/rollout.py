"""Step one episode under the job's conditions. The actions come from a list, from a policy, or from the host."""

from __future__ import annotations

import contextlib
import random
import resource
import time
from typing import Any

import numpy as np
from envcraft_protocol.classes import type_name
from envcraft_protocol.jobs import Conditions, Job
from envcraft_protocol.jobs import Episode as EpisodePlan
from envcraft_protocol.wire import Kind

from . import torch_generator
from .caller import Caller
from .channel import flag, jsonable
from .fields import Fields
from .policy import Policy
from .resources import Lines, Resources
from .returned import Returned
from .spaces import Spaces
from .subject import Fault, Subject

# Bound before any untrusted module can replace them.
_perf_counter = time.perf_counter
_process_time = time.process_time
_thread_time = time.thread_time
_monotonic = time.monotonic
_getrusage = resource.getrusage
_seed, _seed_numpy = random.seed, np.random.seed
_getstate, _setstate = random.getstate, random.setstate
_get_state, _set_state = np.random.get_state, np.random.set_state
_Array = np.ndarray
#: Number of steps that are reported because they changed their action.
_ACTED = 3
#: Seconds of an episode whose job has no time of its own.
_FOR_EVER = 1e9
#: How many times longer than their processor time recorded episodes may take.
_WAITING = 4
#: Steps of a measured episode that do not depend on its time.
_FEWEST = 3
_STRINGS = {str}
#: The conditions that change how actions are passed.
_HABITS = {"reuse", "int32", "python"}


class Perturb:
    """Change the global states of ``random``, ``numpy.random`` and ``torch`` before each call, as other code would."""

    def __init__(self, seed: int | None) -> None:
        self._own = None if seed is None else random.Random(seed)

    def __call__(self) -> None:
        if self._own is not None:
            state = self._own.getrandbits(32)
            _seed(state)
            torch_generator.seed(state)
            _seed_numpy(self._own.getrandbits(32))


class Companion:
    """A second instance of the class, which takes turns with the first."""

    def __init__(self, subject: Subject, plan: EpisodePlan) -> None:
        self._subject = subject
        self._env = subject.construct(announce=False)
        self._seed: int = plan["seed"]
        self._actions: list[Any] = plan["actions"]
        self._position = 0
        self._reset()

    def _reset(self) -> None:
        self._subject.call("companion", self._env.reset, seed=self._seed)
        self._seed += 1

    def step(self) -> None:
        """Step it until its actions end, and restore the global generators: sharing these is another condition."""
        if self._position == len(self._actions):
            return
        state = _global_state()
        self._step()
        _restore(state)

    def _step(self) -> None:
        action = self._actions[self._position]
        self._position += 1
        result = self._subject.step("companion", self._env, action)
        if isinstance(result, tuple) and len(result) == 5 and (_true(result[2]) or _true(result[3])):
            self._reset()


def run(subject: Subject, job: Job, resources: Resources | None = None) -> None:
    """Run the job's episode and stream it; twice under the condition ``again``. With `resources` the episodes before it
    are streamed, too, and measured.
    """
    conditions: Conditions = job.get("conditions", {})
    again = bool(conditions.get("again"))
    state = _global_state() if again else None
    _episode(subject, job, conditions, resources)
    if state is not None:
        _restore(state)
        _episode(subject, job, conditions)


def _episode(subject: Subject, job: Job, conditions: Conditions, resources: Resources | None = None) -> None:
    channel = subject.channel
    if conditions.get("closed"):
        other = subject.construct(announce=False)
        channel.phase("early close")
        subject.call("early close", other.close)
    env = subject.construct(rendered=not conditions.get("unrendered"))
    companion = None
    if "companion" in conditions or "before" in conditions:
        state = _global_state()
        companion = Companion(subject, conditions["companion"]) if "companion" in conditions else None
        allowed = job.get("seconds", _FOR_EVER)
        # Other programs on the machine do not change processor time, and a game that waits uses none.
        busy, until = _process_time() + allowed, _monotonic() + _WAITING * allowed
        for earlier in conditions.get("before", ()):
            if resources is None:
                _play_through(subject, env, earlier)
                if conditions.get("render"):
                    subject.call("render", env.render)
            elif _process_time() < busy and _monotonic() < until:
                _record(subject, env, earlier, resources)
        if not conditions.get("unseeded"):
            # Nothing else may differ from a plain run, so the global generators start in the same state.
            _restore(state)
    perturb = Perturb(conditions.get("perturb"))
    policy = Policy(subject, job["policy"], env) if "policy" in job else None

    reread, renders = bool(conditions.get("reread")), bool(conditions.get("render"))
    spaces = Spaces(subject, env, reread)
    fields = Fields(subject, env) if job.get("fields") else None
    channel.phase("reset")
    perturb()
    seed = None if conditions.get("unseeded") else job["seed"]
    keywords = {"seed": seed, **({"options": job["options"]} if "options" in job else {})}
    measured = bool(job.get("count_waits"))
    waits = _waits() if measured else 0
    started = _perf_counter()
    result = subject.call("reset", fields.watching(env.reset) if fields else env.reset, **keywords)
    seconds = _perf_counter() - started
    channel.waits += measured and _waits() > waits
    if not (isinstance(result, tuple) and len(result) == 2):
        raise Fault({"phase": "reset", "malformed": _shape_of(result), "line": None})
    observation, info = result
    subject.call("reset", channel.step, Kind.RESET, observation, 0.0, False, False, _info(info), seconds)
    _note_info(channel, info)
    if fields:
        fields.send()
    if renders:
        _render(subject, env)
    # Whoever else refers to an observation is counted.
    del result
    returned = Returned(subject, reread)
    returned.add(observation)
    del observation
    spaces.check()
    channel.phase("step")

    caller = Caller(subject, env, conditions) if _HABITS & conditions.keys() else None
    actions: list[Any] = job["actions"]
    acted = _ACTED
    interactive = bool(job.get("interactive"))
    until = _monotonic() + (job.get("seconds", _FOR_EVER) if measured else _FOR_EVER)
    for number in range(job["max_steps"] if policy or interactive else len(actions)):
        if policy:
            chosen = policy.choose()
            channel.action(chosen)
            if actions:
                # The policy only advises.
                chosen = actions[number]
        elif interactive:
            chosen = channel.ask()
        else:
            chosen = actions[number]
        action = caller.action(chosen) if caller else subject.action(chosen, env)
        if companion:
            companion.step()
        perturb()
        was = _bytes(action, reread) if acted else None
        channel.steps += 1
        waits, cpu = (_waits(), _thread_time()) if measured else (0, 0.0)
        started = _perf_counter()
        result = subject.call("step", fields.watching(env.step) if fields else env.step, action)
        seconds = _perf_counter() - started
        if measured:
            waited = _waits() > waits
            channel.waits += waited
            channel.busy += seconds if waited else _thread_time() - cpu
        if not (isinstance(result, tuple) and len(result) == 5):
            raise Fault({"phase": "step", "malformed": _shape_of(result), "line": None})
        if was is not None and _bytes(action, reread) != was:
            acted -= 1
            channel.send_json(Kind.ACTED, {"before": jsonable(subject.action(chosen, env)), "now": jsonable(action)})
        observation, reward, terminated, truncated, info = result
        subject.call("step", channel.step, Kind.STEPS, observation, reward, terminated, truncated, _info(info), seconds)
        _note_info(channel, info)
        if fields:
            fields.send()
        del result
        returned.add(observation)
        if renders:
            _render(subject, env)
        # Freed before the next step, which may then use the same memory.
        del observation
        if number & (number + 1) == 0:
            # After 1, 2, 4, 8 … steps: what changes seldom changes back.
            spaces.check()
        if _true(terminated) or _true(truncated):
            returned.check()
            _step_on(subject, env, actions, int(conditions.get("after_end", 0)))
            break
        if number + 1 >= _FEWEST and _monotonic() > until:
            break
    returned.check()
    spaces.check()
    if "options" in job:
        # Wrappers reset like this, and so does any loop after its first episode.
        channel.phase("plain reset")
        subject.call("plain reset", env.reset, seed=None, options=None)
        returned.check()
        spaces.check()
    returned.clear()
    channel.phase("close")
    for _ in range(2):
        subject.call("close", env.close)


def _waits() -> int:
    """How often this thread has given up the processor before the end of its time slice."""
    return _getrusage(resource.RUSAGE_THREAD).ru_nvcsw


class _Stopwatch:
    """Times a call: the processor time, which other programs on the machine do not change, or all time if it waits.

    It is the time of the thread: under a limit of processor time, Linux counts that of the process in whole ticks.
    """

    seconds = 0.0

    def __enter__(self) -> None:
        self._waits, self._cpu, self._started = _waits(), _thread_time(), _perf_counter()

    def __exit__(self, *_: object) -> None:
        cpu, seconds = _thread_time() - self._cpu, _perf_counter() - self._started
        self.seconds = seconds if _waits() > self._waits else cpu


def _global_state() -> tuple[Any, Any, Any]:
    return _getstate(), _get_state(), torch_generator.get()


def _restore(state: tuple[Any, Any, Any]) -> None:
    torch_generator.put(state[2])
    _setstate(state[0])
    _set_state(state[1])


def _play_through(subject: Subject, env: Any, episode: EpisodePlan) -> None:
    """Play an earlier episode on the same instance, and ignore its results."""
    subject.channel.phase("before")
    subject.call("earlier reset", env.reset, seed=episode["seed"])
    for value in episode["actions"]:
        result = subject.step("before", env, value)
        subject.channel.tick()
        if isinstance(result, tuple) and len(result) == 5 and (_true(result[2]) or _true(result[3])):
            return


def _record(subject: Subject, env: Any, episode: EpisodePlan, resources: Resources) -> None:
    """Play an earlier episode on the same instance, stream it, and measure the process after it."""
    channel = subject.channel
    channel.phase("before")
    lines = Lines()
    counting = lines if episode.get("lines") else contextlib.nullcontext()
    clock = _Stopwatch()
    with counting, clock:
        result = subject.call("earlier reset", env.reset, seed=episode["seed"])
    if not (isinstance(result, tuple) and len(result) == 2):
        raise Fault({"phase": "earlier reset", "malformed": _shape_of(result), "line": None})
    observation, info = result
    subject.call("earlier reset", channel.step, Kind.RESET, observation, 0.0, False, False, _info(info), clock.seconds)
    for value in episode["actions"]:
        # What the last step returned is freed before this one.
        del result, observation, info
        with counting, clock:
            result = subject.step("before", env, value)
        if not (isinstance(result, tuple) and len(result) == 5):
            raise Fault({"phase": "before", "malformed": _shape_of(result), "line": None})
        observation, reward, terminated, truncated, info = result
        subject.call(
            "before", channel.step, Kind.STEPS, observation, reward, terminated, truncated, _info(info), clock.seconds
        )
        if _true(terminated) or _true(truncated):
            break
    del result, observation, info
    # What waits to be sent takes memory, too.
    channel.flush()
    channel.send(Kind.RESOURCES, resources.measure(lines.count), flush=True)


def _step_on(subject: Subject, env: Any, actions: list[Any], count: int) -> None:
    """Step past the end of the episode, which is undefined: an exception is an answer, and any result is sent."""
    if count:
        subject.channel.phase("after")
    for value in (actions * 2)[:count]:
        try:
            result = subject.step("after", env, value)
        except Fault:
            return
        if not (isinstance(result, tuple) and len(result) == 5):
            return
        _, reward, terminated, truncated, _ = result
        subject.call("after", subject.channel.after, reward, terminated, truncated)


def _render(subject: Subject, env: Any) -> None:
    frame = subject.call("render", env.render)
    subject.call("render", subject.channel.render, frame)


def _bytes(action: Any, everything: bool) -> Any:
    """What shows that an action is as it was; None for one that is no array, unless `everything` is compared."""
    if type(action) is _Array:
        return action.tobytes()
    return jsonable(action) if everything else None


def _info(info: Any) -> dict[Any, Any]:
    return info if isinstance(info, dict) else {}


def _note_info(channel: Any, info: Any) -> None:
    if type(info) is dict and {*map(type, info)} <= _STRINGS:
        return
    if not isinstance(info, dict):
        channel.send_json(Kind.FAULT, {"phase": "info", "note": True, "type": type_name(info), "line": None})
    elif any(not isinstance(key, str) for key in info):
        odd = next(key for key in info if not isinstance(key, str))
        channel.send_json(Kind.FAULT, {"phase": "info", "note": True, "key": type_name(odd), "line": None})


def _shape_of(result: Any) -> str:
    if isinstance(result, tuple | list):
        return f"a {type_name(result)} of {len(result)}"
    return "None" if result is None else f"a value of type {type_name(result)}"


def _true(value: Any) -> bool:
    return value if type(value) is bool else bool(flag(value)[1])
