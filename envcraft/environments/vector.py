"""``envcraft.make_vec``: different environments side by side, stepped by Gymnasium's own vector environments.

What this module adds to Gymnasium: the environments have names, which errors contain; infos of different environments
share a batch (:mod:`envcraft.environments.infos`); wrong arguments are refused before any environment is called; and
after an error everything is closed.
"""

from __future__ import annotations

import contextlib
import inspect
import multiprocessing.connection
import os
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorWrapper
from gymnasium.vector.async_vector_env import AsyncState, _async_worker
from numpy.typing import NDArray

from envcraft.environments.factory import open_env
from envcraft.environments.families import simulate
from envcraft.environments.infos import add_info, plain
from envcraft.environments.sources import VARIABLE, EnvSource, default_corpus, resolve
from envcraft.errors import EnvCraftError, EnvironmentFailed, UsageError

try:
    from gymnasium.vector import AutoresetMode
except ImportError:
    raise UsageError("make_vec needs Gymnasium 1.1 or later, which has autoreset modes") from None

#: In worker processes pygame opens no window and plays no sound.
_VARIABLES = {"SDL_VIDEODRIVER": "dummy", "SDL_AUDIODRIVER": "dummy", "PYGAME_HIDE_SUPPORT_PROMPT": "1"}
_EXIT_SECONDS = 5.0


class NamedVectorEnv(VectorWrapper[Any, Any, Any, Any, Any]):
    """A Gymnasium vector whose environments have names.

    After an error the vector is closed. A wrong argument is refused before any environment is called, and closes
    nothing.

    Attributes:
        names: The environments' names, in order.
    """

    def __init__(
        self, env: gymnasium.vector.VectorEnv[Any, Any, Any], names: Sequence[str], takes_options: bool = True
    ) -> None:
        """Wrap a vector.

        Args:
            env: The vector.
            names: One name for each of its environments.
            takes_options: Whether the environments' ``reset()`` takes options; those in sandboxes take none.
        """
        super().__init__(env)
        self.names = tuple(names)
        self._takes_options = takes_options
        self._needs_reset = np.ones(env.num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset all environments, or with ``options["reset_mask"]`` those where the mask is True.

        Args:
            seed: Environment `i` gets ``seed + i``, or the `i`-th of several seeds.
            options: A boolean array ``reset_mask`` of shape ``(num_envs,)``; all other options go to the environments.

        Returns:
            The batched observations and infos.

        Raises:
            EnvironmentFailed: An environment raises an error or its process ends.
            UsageError: The environments take no options.
            ValueError: A seed or the mask is wrong.
        """
        seeds = seed_list(seed, self.num_envs)
        mask = np.ones(self.num_envs, np.bool_)
        if options and "reset_mask" in options:
            mask = options["reset_mask"]
            if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)):
                raise ValueError(f"reset_mask must be a boolean array of shape ({self.num_envs},)")
            if not mask.any():
                raise ValueError("reset_mask selects no environment: at least one value must be True")
        if not self._takes_options and set(options or {}) - {"reset_mask"}:
            raise UsageError(f"{self.names[0]} runs in a sandbox, where reset() takes no options")
        with self._closing():
            # A copy, because Gymnasium removes the mask from it.
            given: Any = {"seed": seeds, "options": dict(options) if options else None}
            result: tuple[Any, dict[str, Any]] = self.env.reset(**given)
        self._needs_reset[mask] = False
        return result

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step all environments; those whose episode has ended are reset as the autoreset mode says.

        Args:
            actions: A batch of actions, one row for each environment.

        Returns:
            Batched observations, rewards, terminated and truncated flags of shape ``(num_envs,)``, and infos.

        Raises:
            ResetNeeded: Before the first reset, and without autoreset after an episode's end.
            EnvironmentFailed: An environment raises an error or its process ends.
            ValueError: The actions have another shape.
            TypeError: The actions have another kind of dtype.
        """
        if self._needs_reset.any() and not self.closed:
            numbers = ", ".join(map(str, np.flatnonzero(self._needs_reset)))
            raise ResetNeeded(f"environments {numbers} need a reset; options={{'reset_mask': mask}} selects them")
        space = self.action_space
        if space.shape is not None and (dtype := space.dtype) is not None:
            given = np.asarray(actions)
            if given.shape != space.shape:
                raise ValueError(f"the actions have the shape {given.shape}, not {space.shape}")
            if not np.can_cast(given.dtype, dtype, "same_kind"):
                raise TypeError(f"the actions are of dtype {given.dtype}, which is not of the same_kind as {dtype}")
            actions = given.astype(dtype, copy=False)
        with self._closing():
            results: Any = self.env.step(actions)
        if self.metadata["autoreset_mode"] is AutoresetMode.DISABLED:
            self._needs_reset = results[2] | results[3]
        return results  # type: ignore[no-any-return] # Gymnasium leaves the types of vectors open

    def render(self) -> tuple[Any, ...] | None:
        """What each environment's ``render()`` returns. Raises EnvironmentFailed."""
        with self._closing():
            return self.env.render()

    @contextlib.contextmanager
    def _closing(self) -> Iterator[None]:
        """Close the vector if the call fails, also by Ctrl-C: the next call would take the result that is still
        pending for its own.
        """
        if self.closed:
            raise ClosedEnvironmentError("the vector is closed: make another one")
        try:
            yield
        except BaseException:
            self.close()
            raise


class _NamedEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """One environment of a vector. Its errors name it, and what it returns is checked against its spaces."""

    def __init__(self, env: gymnasium.Env[Any, Any], label: str, crosses: bool) -> None:
        """Wrap an environment.

        Args:
            env: The environment.
            label: What errors call it.
            crosses: Whether infos and frames go to another process.
        """
        super().__init__(env)
        self._label, self._crosses = label, crosses
        self._form = env.observation_space.shape, env.observation_space.dtype

    def reset(self, **keywords: Any) -> tuple[Any, dict[str, Any]]:
        try:
            observation, info = self.env.reset(**keywords)
            return self._checked(observation), self._info(info)
        except EnvCraftError:
            raise
        except (Exception, SystemExit) as error:
            raise EnvironmentFailed(f"{self._label} raised in reset(): {_words(error)}") from error

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        try:
            observation, reward, terminated, truncated, info = self.env.step(action)
            ended = bool(terminated), bool(truncated)
            return self._checked(observation), float(reward), *ended, self._info(info)
        except EnvCraftError:
            raise
        except (Exception, SystemExit) as error:
            raise EnvironmentFailed(f"{self._label} raised in step(): {_words(error)}") from error

    def render(self) -> Any:
        try:
            frame = self.env.render()
            return plain(frame) if self._crosses else frame
        except EnvCraftError:
            raise
        except (Exception, SystemExit) as error:
            raise EnvironmentFailed(f"{self._label} raised in render(): {_words(error)}") from error

    def close(self) -> None:
        """Close the environment and ignore the errors that this raises."""
        with contextlib.suppress(Exception, SystemExit):
            self.env.close()

    def _info(self, info: Any) -> dict[str, Any]:
        if not isinstance(info, dict):
            raise TypeError(f"info is of type {type(info).__name__}, not dict")
        return plain(info) if self._crosses else info

    def _checked(self, observation: Any) -> Any:
        """Gymnasium's errors about a batch do not say which environment is at fault, and shared memory casts silently.

        Raises ValueError, TypeError.
        """
        shape, dtype = self._form
        if shape is None or (type(observation) is np.ndarray and (observation.shape, observation.dtype) == self._form):
            return observation
        array = np.asarray(observation)
        if array.shape != shape:
            raise ValueError(f"an observation of shape {array.shape}, and the space has {shape}")
        if dtype is not None and not np.can_cast(array.dtype, dtype, "same_kind"):
            raise TypeError(f"an observation of dtype {array.dtype}, which is not of the same_kind as {dtype}")
        return observation


class _SyncVectorEnv(SyncVectorEnv[Any, Any]):
    """Environments in this process."""

    def __init__(self, makers: Sequence[Callable[[], _NamedEnv]], names: Sequence[str], copy: bool, mode: Any) -> None:
        envs: list[_NamedEnv] = []
        try:
            envs.extend(maker() for maker in makers)
            spaces = [(env.observation_space, env.action_space) for env in envs]
            _ensure_equal_spaces(names, spaces)
            super().__init__([partial(_identity, env) for env in envs], copy=copy, autoreset_mode=mode)
        except BaseException:
            for env in envs:
                env.close()
            raise

    def _add_info(self, vector_infos: dict[str, Any], env_info: dict[str, Any], env_num: int) -> dict[str, Any]:
        return add_info(vector_infos, env_info, env_num, self.num_envs)


class _AsyncVectorEnv(AsyncVectorEnv[Any, Any]):
    """Environments in a process each."""

    def __init__(
        self, makers: Sequence[Callable[[], _NamedEnv]], names: Sequence[str], copy: bool, mode: Any, workers: int
    ) -> None:
        self._names = tuple(names)
        # Gymnasium before 1.4 steps all environments at once.
        limited = "max_concurrency" in inspect.signature(AsyncVectorEnv).parameters and workers < len(makers)
        limit: dict[str, Any] = {"max_concurrency": workers} if limited else {}
        worker: Any = _worker
        try:
            super().__init__(makers, copy=copy, worker=worker, autoreset_mode=mode, **limit)
        except BaseException:
            if hasattr(self, "_state"):
                self.close(terminate=True)
            raise

    def _add_info(self, vector_infos: dict[str, Any], env_info: dict[str, Any], env_num: int) -> dict[str, Any]:
        return add_info(vector_infos, env_info, env_num, self.num_envs)

    def _check_spaces(self) -> None:
        """Raise an error that names the environment. Raises UsageError, EnvironmentFailed."""
        with self._processes_named():
            spaces = zip(self.get_attr("observation_space"), self.get_attr("action_space"), strict=True)
        _ensure_equal_spaces(self._names, list(spaces))

    def _raise_if_errors(self, successes: Any) -> None:
        """Raise the environment's own error, with its traceback as a note. Gymnasium prints that as a warning.

        Raises EnvCraftError.
        """
        if not all(successes):
            _, kind, words, trace = self.error_queue.get()
            failure = kind(words)
            failure.add_note(f"In its process:\n{trace.rstrip()}")
            raise failure

    def reset(self, **keywords: Any) -> tuple[Any, dict[str, Any]]:
        with self._processes_named():
            return super().reset(**keywords)

    def step(self, actions: Any) -> Any:
        with self._processes_named():
            return super().step(actions)

    def render(self) -> Any:
        with self._processes_named():
            return super().render()

    def close_extras(self, timeout: float | None = None, terminate: bool = False) -> None:
        """Close the environments and end their processes; by a signal if one has ended or a call was interrupted."""
        if self._state is not AsyncState.DEFAULT or not all(process.is_alive() for process in self.processes):
            self._state, terminate = AsyncState.DEFAULT, True
        super().close_extras(timeout, terminate)

    @contextlib.contextmanager
    def _processes_named(self) -> Iterator[None]:
        """Report whose process ended. Raises EnvironmentFailed."""
        try:
            yield
        except (EOFError, ConnectionError):
            sentinels = [process.sentinel for process in self.processes]
            ended = multiprocessing.connection.wait(sentinels, _EXIT_SECONDS)
            for index, process in enumerate(self.processes):
                if process.sentinel not in ended:
                    continue
                process.join(_EXIT_SECONDS)
                status = process.exitcode
                if status is not None:
                    reason = f"signal {-status}" if status < 0 else f"exit status {status}"
                    label = _label(index, self._names[index])
                    raise EnvironmentFailed(f"{label} ended its process ({reason})") from None
            raise


class _Failures:
    """Gymnasium's queue of errors, without the objects of an environment.

    An error that cannot be pickled never arrives, and the vector would wait for it for ever.
    """

    def __init__(self, queue: Any) -> None:
        self._queue = queue

    def put(self, failure: tuple[int, type[BaseException], BaseException, str]) -> None:
        index, kind, error, trace = failure
        own = issubclass(kind, EnvCraftError)
        self._queue.put((index, kind if own else EnvironmentFailed, str(error) if own else _words(error), trace))


def _worker(
    index: int, maker: Callable[[], _NamedEnv], pipe: Any, parent_pipe: Any, shared: Any, errors: Any, *others: Any
) -> None:
    """Gymnasium's worker, which also reports why an environment cannot be made."""
    # A terminal sends Ctrl-C to all processes; the vector ends its own.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name, value in _VARIABLES.items():
        os.environ.setdefault(name, value)
    failures: Any = _Failures(errors)
    try:
        env = maker()
    except BaseException as error:
        parent_pipe.close()
        failures.put((index, type(error), error, traceback.format_exc()))
        pipe.recv()
        pipe.send((None, False))
        return
    _async_worker(index, partial(_identity, env), pipe, parent_pipe, shared, failures, *others)


def _open(
    index: int, source: EnvSource, sandbox: str | None, runtime: str | None, kwargs: dict[str, Any], crosses: bool
) -> _NamedEnv:
    """Make one environment of a vector. Raises EnvCraftError, which names it."""
    label = _label(index, source.name)
    try:
        return _NamedEnv(open_env(source, True, sandbox, runtime, kwargs), label, crosses)
    except EnvCraftError:
        raise
    except (Exception, SystemExit) as error:
        raise EnvironmentFailed(f"{label} could not be made: {_words(error)}") from error


def _identity(env: _NamedEnv) -> _NamedEnv:
    return env


def _label(index: int, name: str) -> str:
    return f"environment {index} ({name})"


def _words(error: BaseException) -> str:
    """The type and message of an error of the environment's; reading the message may raise an error itself."""
    kind = type(error).__name__
    try:
        return f"{kind}: {error}"
    except Exception:
        return kind


def _ensure_equal_spaces(names: Sequence[str], spaces: Sequence[tuple[Any, Any]]) -> None:
    """Raises UsageError if an environment's spaces differ from those of the first."""
    for name, pair in zip(names, spaces, strict=True):
        for kind, space, first in zip(("observation", "action"), pair, spaces[0], strict=True):
            if space != first:
                raise UsageError(
                    f"the {kind} space of {name} is {space}, but that of {names[0]} is {first}: the environments of a "
                    "vector must have the same spaces"
                )


def seed_list(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """One seed for each of `count` environments: ``seed + i``, or the `i`-th of several. Raises ValueError."""
    if seed is None or isinstance(seed, int | np.integer):
        seeds = [None if seed is None else int(seed) + index for index in range(count)]
    else:
        seeds = [None if one is None else int(one) for one in seed]
    if len(seeds) != count:
        raise ValueError(f"{len(seeds)} seeds for {count} environments")
    if negative := [seed for seed in seeds if seed is not None and seed < 0]:
        raise ValueError(f"the seed {negative[0]} is negative")
    return seeds


def autoreset_mode_named(mode: AutoresetMode | str) -> AutoresetMode:
    """The autoreset mode with this value. Raises UsageError."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        known = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise UsageError(f"there is no autoreset mode {mode!r}; choose from {known}") from None


def make_vec(
    names: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    num_envs: int | None = None,
    *,
    corpus: str | os.PathLike[str] | None = None,
    contract: str | None = None,
    trust: bool = False,
    sandbox: str | None = None,
    runtime: str | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    workers: int | None = None,
    copy: bool = True,
    fast: bool = False,
    **kwargs: Any,
) -> NamedVectorEnv:
    """Make many environments that are stepped side by side: environment `i` is ``names[i % len(names)]``.

    Args:
        names: Environments of `corpus`; without `corpus` also Python files.
        num_envs: The number of environments; by default one for each name.
        corpus: Where names are looked up; by default the corpus that ENVCRAFT_CORPUS or ``[tool.envcraft]`` names.
        contract, trust, sandbox, runtime: As in :func:`envcraft.make`, for all environments. With `sandbox` each
            environment has its own sandbox.
        autoreset_mode: What follows the end of an episode: ``NextStep``, ``SameStep`` or ``Disabled``.
        workers: By default, and with 0, all environments are stepped in this process, one after the other
            (``SyncVectorEnv``). With `n`, each environment has its own process, and `n` of them are stepped at once
            (``AsyncVectorEnv``), which is faster if their steps take longer than waking the processes.
        copy: Return copies of the observations instead of the memory that the next step overwrites.
        fast: Let the family that wrote the environments play them in this process by its own simulator, with the same
            frames, rewards, flags and infos. None of the files' code runs, so none has to be trusted. A file that
            differs from what the family writes is refused.
        kwargs: Arguments for each constructor. With `sandbox`, they are JSON, and ``render_mode="rgb_array"`` makes
            ``render()`` return frames.

    Returns:
        A Gymnasium ``VectorEnv`` with the attribute ``names``.

    Raises:
        Untrusted: As :func:`envcraft.make`; no environment is started then.
        UsageError: An environment does not exist, or spaces differ.
        EnvironmentFailed: An environment cannot be made.
    """
    wanted = list(names) if isinstance(names, Sequence) and not isinstance(names, str) else [names]
    for name in wanted:
        if not isinstance(name, str | os.PathLike):
            raise UsageError(f"{name!r} is not the name of an environment, and not a file; make_vec takes these")
    if not isinstance(num_envs, int | None):
        words = "make_vec takes all names as one list first, and their corpus as corpus="
        raise UsageError(f"num_envs is {num_envs!r}, not a whole number; {words}")
    count = len(wanted) if num_envs is None else num_envs
    if not wanted:
        raise UsageError("make_vec has no names; give at least one")
    if count < 1:
        raise UsageError(f"num_envs is {count}; it must be 1 or more")
    if workers is not None and workers < 0:
        raise UsageError(f"workers={workers}: give the number of environments to step at once, or 0")
    mode = autoreset_mode_named(autoreset_mode)
    sources = [_resolve(name, corpus, contract) for name in wanted[:count]]
    chosen = [sources[index % len(sources)] for index in range(count)]
    titles = [source.name for source in chosen]
    if fast:
        if sandbox is not None or kwargs:
            raise UsageError("fast=True takes no sandbox and no constructor arguments, because no file's code runs")
        return NamedVectorEnv(simulate(chosen, mode, copy), titles)
    if sandbox is None and not trust:
        for source in sources:
            source.ensure_trusted()
    makers = [
        partial(_open, index, source, sandbox, runtime, kwargs, bool(workers)) for index, source in enumerate(chosen)
    ]
    if workers:
        return NamedVectorEnv(_AsyncVectorEnv(makers, titles, copy, mode, workers), titles, sandbox is None)
    return NamedVectorEnv(_SyncVectorEnv(makers, titles, copy, mode), titles, sandbox is None)


def _resolve(name: str | os.PathLike[str], corpus: str | os.PathLike[str] | None, contract: str | None) -> EnvSource:
    """Look in the given corpus; else at the file, or else in the default corpus."""
    place = corpus if corpus is not None or Path(name).is_file() else default_corpus()
    if place is None and not Path(name).exists():
        raise UsageError(f"{name} is not a file, and no corpus is named: give corpus=, or set {VARIABLE}")
    return resolve(name, None, contract) if place is None else resolve(place, os.fspath(name), contract)
