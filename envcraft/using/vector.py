"""``envcraft.make_vec``: many different environments side by side, as a Gymnasium ``VectorEnv``.

A few worker processes have several whole environments each and write observations, rewards and flags straight into
memory that is shared; a step takes one event for all and one byte back from each. Only infos travel, as plain data.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from envcraft import spaces as described
from envcraft.errors import UsageError
from envcraft.using.fast import simulator
from envcraft.using.group import Arrays, Info, Layout, Member
from envcraft.using.processes import InProcess, Processes
from envcraft.using.sources import VARIABLE, Found, default_corpus, locate
from envcraft.using.spaces import to_gymnasium

try:
    from gymnasium.vector import AutoresetMode
except ImportError:
    raise UsageError("make_vec needs Gymnasium 1.1 or later, which has autoreset modes") from None

#: Spaces whose values are arrays of one size.
_FIXED = ("Box", "Discrete", "MultiDiscrete", "MultiBinary")
#: What a column of an info has for Python's own numbers.
_PYTHON = {int: np.dtype(int), float: np.dtype(float), bool: np.dtype(bool)}


class Running(Protocol):
    """The environments of a vector: in processes, in this one, or as one program that plays them all.

    Attributes:
        spaces: a description of each one's.
        groups: how many processes share the arrays.
    """

    spaces: list[dict[str, Any]]

    @property
    def groups(self) -> int: ...

    def attach(self, layout: Layout, same_step: bool) -> Arrays:
        """Give the arrays; with `same_step`, a step that ends an episode also begins the next one."""

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None) -> Sequence[Info] | dict[str, Any]:
        """Reset those whose bit in ``resets`` is set, and give their infos, each by itself or all batched."""

    def step(self) -> Sequence[Info] | dict[str, Any]:
        """Step each with its action, or reset it where its bit in ``resets`` is set."""

    def render(self) -> list[Any]:
        """What each one's render() gives."""

    def close(self) -> None:
        """Close them. May be called twice."""


class VectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """The environments that `running` has, by their names; :func:`make_vec` says the rest.

    Once an environment fails, EnvironmentFailed names it and everything is closed.

    Attributes:
        names: of the environments, in order.
    """

    def __init__(
        self,
        names: Sequence[str],
        running: Running,
        autoreset_mode: AutoresetMode,
        copy: bool,
        render_mode: str | None = "rgb_array",
    ) -> None:
        """Take what runs them. Raises UsageError where their spaces differ or are of no fixed size, and closes it."""
        self.names = tuple(names)
        self.num_envs = len(self.names)
        self.closed = False
        self._mode, self._copy = autoreset_mode, copy
        self._running = running
        try:
            self._agree(running.spaces)
            observation, action = self.single_observation_space, self.single_action_space
            layout = Layout(self.num_envs, _form(observation), _form(action), running.groups)
            self._arrays = self._running.attach(layout, autoreset_mode is AutoresetMode.SAME_STEP)
        except BaseException:
            self.close()
            raise
        self.observation_space = batch_space(observation, self.num_envs)
        self.action_space = batch_space(action, self.num_envs)
        self.metadata = {"autoreset_mode": autoreset_mode, "render_modes": ["rgb_array"]}
        self.render_mode = render_mode
        self._begun = np.zeros(self.num_envs, np.bool_)
        self._ended = np.zeros(self.num_envs, np.bool_)

    def _agree(self, spaces: list[dict[str, Any]]) -> None:
        """Take the spaces of the first, which all must have."""
        for kind in ("observation", "action"):
            first = spaces[0][kind]
            if first["type"] not in _FIXED:
                raise UsageError(
                    f"the {kind} space of {self.names[0]} is {described.describe(first)}; make_vec steps environments "
                    f"whose spaces are {', '.join(_FIXED)}"
                )
            for name, other in zip(self.names, spaces, strict=True):
                if not described.same(first, other[kind]):
                    raise UsageError(
                        f"the {kind} space of {name} is {described.describe(other[kind])}, and that of {self.names[0]} "
                        f"{described.describe(first)}: side by side they must have the same"
                    )
            space = to_gymnasium(first, f"the {kind} space of {self.names[0]}")
            setattr(self, f"single_{kind}_space", space)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset all, or with ``options["reset_mask"]`` those where the mask is True.

        Environment `i` gets ``seed + i``, or the `i`-th of several seeds. Raises EnvironmentFailed, UsageError.
        """
        if seed is None or isinstance(seed, int | np.integer):
            seeds = [None if seed is None else int(seed) + index for index in range(self.num_envs)]
        else:
            seeds = [None if one is None else int(one) for one in seed]
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds for {self.num_envs} environments")
        if wrong := [seed for seed in seeds if seed is not None and seed < 0]:
            raise ValueError(f"the seed {wrong[0]}: a seed is 0 or more")
        given = {key: value for key, value in (options or {}).items() if key != "reset_mask"} or None
        mask = self._mask(options["reset_mask"]) if options and "reset_mask" in options else np.True_
        self._arrays.resets[:] = mask
        infos = self._guarded(self._running.reset, seeds, given)
        self._ended[self._arrays.resets] = False
        self._begun |= self._arrays.resets
        return self._observations(), self._gathered(infos)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step all, resetting those that have ended as the autoreset mode says.

        Raises ValueError on actions of another shape, ResetNeeded before the first reset and, without autoreset, where
        an episode has ended; EnvironmentFailed.
        """
        if not self._begun.all():
            raise ResetNeeded("call reset() before step()")
        ended = self._ended
        if self._mode is AutoresetMode.DISABLED and ended.any():
            over = ", ".join(map(str, np.flatnonzero(ended)))
            raise ResetNeeded(f"environments {over} have ended: reset them with options={{'reset_mask': mask}}")
        arrays = self._arrays
        actions = np.asarray(actions)
        if actions.shape != arrays.actions.shape:
            raise ValueError(f"actions of shape {actions.shape}, where {arrays.actions.shape} is wanted")
        np.copyto(arrays.actions, actions, casting="same_kind")
        arrays.resets[:] = ended if self._mode is AutoresetMode.NEXT_STEP else False
        infos = self._guarded(self._running.step)
        terminated, truncated = arrays.terminated.copy(), arrays.truncated.copy()
        self._ended = terminated | truncated
        return self._observations(), arrays.rewards.copy(), terminated, truncated, self._gathered(infos)

    def render(self) -> tuple[Any, ...]:
        """What each environment's render() gives. Raises EnvironmentFailed."""
        return tuple(self._guarded(self._running.render))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environments and end the processes."""
        self._running.close()

    def __del__(self) -> None:
        """Close what is no longer held, as Gymnasium's own does: its processes would stay until this one ends."""
        if not getattr(self, "closed", True):
            self.close()

    def _guarded(self, call: Any, *args: Any) -> Any:
        """After a failure, calls have nothing to go to."""
        if self.closed:
            raise ResetNeeded("the vector is closed: make another one")
        try:
            return call(*args)
        except UsageError:
            # Of what cannot be asked, nobody has heard.
            raise
        except BaseException:
            self.close()
            raise

    def _mask(self, mask: Any) -> NDArray[np.bool_]:
        if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)):
            raise ValueError(f"reset_mask must be a boolean array of shape ({self.num_envs},)")
        if not mask.any():
            raise ValueError("reset_mask names no environment: one of it must be True")
        return mask

    def _observations(self) -> NDArray[Any]:
        """A copy, unless none is wanted: then they are overwritten by the next call."""
        return self._arrays.observations.copy() if self._copy else self._arrays.observations

    def _add_info(self, vector_infos: dict[str, Any], env_info: dict[str, Any], env_num: int) -> dict[str, Any]:
        """As Gymnasium's own, which makes a mask for each value before it looks whether there is one."""
        for key, value in env_info.items():
            mask = vector_infos.get(f"_{key}")
            if mask is None:
                mask = vector_infos[f"_{key}"] = np.zeros(self.num_envs, np.bool_)
            mask[env_num] = True
            column = vector_infos.get(key)
            if isinstance(value, dict) and key != "final_obs" and (column is None or isinstance(column, dict)):
                vector_infos[key] = self._add_info(column or {}, value, env_num)
                continue
            if column is None:
                column = vector_infos[key] = _column(key, value, self.num_envs)
            elif isinstance(column, dict) or not _fits(column, value):
                column = vector_infos[key] = _wider(column, mask, _column(key, value, self.num_envs))
            column[env_num] = value
        return vector_infos

    def _gathered(self, infos: Sequence[Info] | dict[str, Any]) -> dict[str, Any]:
        """Infos as Gymnasium batches them: an array for each key, and a mask ``_key``."""
        if isinstance(infos, dict):
            return infos
        gathered: dict[str, Any] = {}
        for index, final, info in infos:
            if final:
                # An element of a Discrete space is a number, not an array of none.
                info = {"final_obs": self._arrays.finals[index].copy()[()], "final_info": info}
            gathered = self._add_info(gathered, info, index)
        return gathered


def _column(key: str, value: Any, count: int) -> NDArray[Any]:
    """What holds the values of one key of info, by the first of them."""
    if key != "final_obs" and not _is_long(value):
        if type(value) in (int, float, bool) or isinstance(value, np.number):
            return np.zeros(count, type(value))
        if isinstance(value, np.ndarray):
            return np.zeros((count, *value.shape), value.dtype)
    return np.full(count, None, object)


def _fits(column: NDArray[Any], value: Any) -> bool:
    """Whether a column can have a value as it is."""
    if column.dtype == object:
        return True
    if type(value) in _PYTHON:
        return column.ndim == 1 and column.dtype == _PYTHON[type(value)] and not _is_long(value)
    numbers = isinstance(value, np.number | np.ndarray)
    return numbers and column.dtype == value.dtype and column.shape[1:] == value.shape


def _is_long(value: Any) -> bool:
    return type(value) is int and not -(2**63) <= value < 2**63


def _wider(column: NDArray[Any] | dict[str, Any], mask: NDArray[np.bool_], other: NDArray[Any]) -> NDArray[Any]:
    """What has the values of a column where `mask` says that there are any, and takes those that `other` takes: games
    side by side may mean different things by one key.
    """
    if (
        not isinstance(column, dict)
        and column.shape == other.shape
        and {column.dtype.kind, other.dtype.kind} <= set("iuf")
    ):
        return column.astype(np.result_type(column, other))
    wider = np.full(len(mask), None, object)
    for index in np.flatnonzero(mask).tolist():
        wider[index] = _apart(column, index) if isinstance(column, dict) else column[index]
    return wider


def _apart(infos: dict[str, Any], index: int) -> dict[str, Any]:
    """What one environment has of batched infos."""
    own = [key for key in infos if f"_{key}" in infos and infos[f"_{key}"][index]]
    return {key: _apart(infos[key], index) if isinstance(infos[key], dict) else infos[key][index] for key in own}


def _form(space: gymnasium.Space[Any]) -> tuple[tuple[int, ...], str]:
    """Shape and dtype of a space's values."""
    assert space.shape is not None
    assert space.dtype is not None
    return space.shape, np.dtype(space.dtype).str


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
) -> VectorEnv:
    """Make many environments that are stepped side by side: environment `i` is ``names[i % len(names)]``.

    Args:
        names: environments of `corpus`; without it also Python files.
        num_envs: how many; by default as many as names.
        corpus: where names are looked up; by default the corpus that ENVCRAFT_CORPUS or ``[tool.envcraft]`` names.
        contract, trust, sandbox, runtime: as :func:`envcraft.make` takes them, for all. Code that has passed runs in
            the worker processes; with `sandbox` each environment has a sandbox of its own.
        autoreset_mode: what follows an episode's end: ``NextStep``, ``SameStep`` or ``Disabled``.
        workers: how many processes; by default one for each core. With 0 the environments run in this process, which is
            faster where all their steps together take no longer than waking the processes.
        copy: give copies of the observations, and not the memory that the next step overwrites.
        fast: let the family that wrote the environments play them, in this process, by a program of its own that does
            what their files do: frames, rewards, flags and infos are the same. None of the files' code runs, so
            that none has to be trusted; a file that is not as the family writes it is refused.
        kwargs: for each constructor; plain data. With `sandbox`, ``render_mode="rgb_array"`` is what makes render()
            give frames.

    Raises:
        Untrusted: as :func:`envcraft.make`; none is started then.
        UsageError: an environment does not exist, or spaces differ.
        EnvironmentFailed: an environment cannot be made.
    """
    wanted = [names] if isinstance(names, str | os.PathLike) else list(names)
    count = len(wanted) if num_envs is None else num_envs
    if not wanted or count < 1:
        raise UsageError(f"make_vec needs names and at least one environment, and has {len(wanted)} and {count}")
    mode = mode_named(autoreset_mode)
    found = [_locate(name, corpus, contract) for name in wanted[:count]]
    if fast:
        if sandbox is not None or kwargs:
            raise UsageError("fast=True takes neither a sandbox nor arguments for constructors: no file's code runs")
        chosen = [found[index % len(found)] for index in range(count)]
        return VectorEnv([one.name for one in chosen], simulator(chosen), mode, copy)
    if sandbox is None and not trust:
        for one in found:
            one.ensure_trusted()
    if workers is not None and workers < 0:
        raise UsageError(f"workers={workers}: name how many processes there are to be, or 0 for none")
    members = [_member(index, found[index % len(found)], sandbox, runtime, kwargs) for index in range(count)]
    cores = len(os.sched_getaffinity(0))
    processes = min(cores if workers is None else workers, count)
    running: Running = Processes(members, processes) if processes else InProcess(members)
    # Of what a sandbox runs, frames come only where they are asked for: each takes as long as a step.
    shown = kwargs.get("render_mode") or ("rgb_array" if sandbox is None else None)
    return VectorEnv([member.name for member in members], running, mode, copy, shown)


def _locate(name: str | os.PathLike[str], corpus: str | os.PathLike[str] | None, contract: str | None) -> Found:
    """In the corpus that was given; else a file that is there, or in the corpus that is named elsewhere."""
    place = corpus if corpus is not None or Path(name).is_file() else default_corpus()
    if place is None and not Path(name).exists():
        raise UsageError(f"{name} is no file, and no corpus is named that has it: give corpus=, or set {VARIABLE}")
    return locate(name, None, contract) if place is None else locate(place, os.fspath(name), contract)


def _member(index: int, found: Found, sandbox: str | None, runtime: str | None, kwargs: dict[str, Any]) -> Member:
    return Member(
        index,
        found.name,
        found.path,
        found.sha256,
        found.env_class,
        found.contract,
        kwargs,
        found.source if sandbox is not None else b"",
        sandbox,
        runtime,
    )


def mode_named(given: AutoresetMode | str) -> AutoresetMode:
    """Raises UsageError."""
    if isinstance(given, AutoresetMode):
        return given
    try:
        return AutoresetMode(given)
    except ValueError:
        there = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise UsageError(f"there is no autoreset mode {given!r}; there are {there}") from None
