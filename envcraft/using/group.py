"""Several environments stepped one after another, their results written straight into arrays that the caller shares."""

from __future__ import annotations

import contextlib
import mmap
from collections.abc import Sequence
from typing import Any

import gymnasium
import msgspec
import numpy as np
from envcraft_runtime.spaces import describe
from numpy.typing import NDArray

from envcraft.contract import Contract

#: Where each array begins, in bytes: a line of the processor's cache.
_ALIGNMENT = 64

#: What an info is about: the index of its environment, whether it is that of an episode's end, and the info.
Info = tuple[int, bool, dict[str, Any]]


class Member(msgspec.Struct, frozen=True):
    """One environment of a vector: all that a process needs to make it, as plain data.

    `sandbox` is None for what runs in the process itself; `source` is empty then, and read from `path`.
    """

    index: int
    name: str
    path: str
    sha256: str
    env_class: str | None
    contract: Contract
    kwargs: dict[str, Any]
    source: bytes = b""
    sandbox: str | None = None
    runtime: str | None = None

    def open(self) -> gymnasium.Env[Any, Any]:
        """Make it. Raises EnvCraftError, and OSError where its source is gone."""
        if self.sandbox is not None:
            from envcraft.using.sandboxed import open_sandboxed

            return open_sandboxed(
                self.name, self.source, self.env_class, self.contract, self.sandbox, self.runtime, self.kwargs
            )
        from envcraft.using.loading import open_trusted

        with open(self.path, "rb") as file:
            source = file.read()
        adapter = self.contract.adapter
        return open_trusted(self.name, self.path, source, self.sha256, self.env_class, adapter, self.kwargs)


class Layout(msgspec.Struct, frozen=True):
    """The sizes of a vector's arrays. `workers` is the number of groups that share them."""

    count: int
    observation: tuple[tuple[int, ...], str]
    action: tuple[tuple[int, ...], str]
    workers: int = 1

    def parts(self) -> list[tuple[str, tuple[int, ...], str]]:
        n = self.count
        return [
            ("observations", (n, *self.observation[0]), self.observation[1]),
            ("finals", (n, *self.observation[0]), self.observation[1]),
            ("actions", (n, *self.action[0]), self.action[1]),
            ("rewards", (n,), "<f8"),
            ("terminated", (n,), "|b1"),
            ("truncated", (n,), "|b1"),
            ("resets", (n,), "|b1"),
            ("current", (self.workers,), "<i8"),
        ]

    @property
    def size(self) -> int:
        """Bytes of all arrays."""
        return sum(_padded(shape, dtype) for _, shape, dtype in self.parts())


class Arrays:
    """A vector's arrays, those of `buffer` or else of this process alone. Row `i` is environment `i`'s.

    Attributes:
        observations: of the last call.
        finals: the last observation of episodes that ended in a step that reset them, too.
        resets: environments that the next step resets instead, or that a reset is about.
        current: for each group the index of the environment that is being called, or -1.
    """

    observations: NDArray[Any]
    finals: NDArray[Any]
    actions: NDArray[Any]
    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    resets: NDArray[np.bool_]
    current: NDArray[np.int64]

    def __init__(self, layout: Layout, buffer: mmap.mmap | None = None) -> None:
        memory: Any = buffer if buffer is not None else bytearray(layout.size)
        offset = 0
        for name, shape, dtype in layout.parts():
            setattr(self, name, np.ndarray(shape, dtype, memory, offset))
            offset += _padded(shape, dtype)


def _padded(shape: tuple[int, ...], dtype: str) -> int:
    size = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
    return -(-size // _ALIGNMENT) * _ALIGNMENT


class Crash(Exception):
    """An environment raised, or returned what does not fit: which one, in what call, and how."""

    def __init__(self, index: int, phase: str, error: BaseException) -> None:
        super().__init__(index, phase, error)
        self.index, self.phase, self.error = index, phase, error

    @property
    def words(self) -> str:
        """What was raised: its own message may raise, too."""
        kind = type(self.error).__name__
        try:
            return f"{kind}: {self.error}"
        except Exception:
            return kind


class Group:
    """Environments `members`, the group with number `number` among those that share the arrays."""

    def __init__(self, members: Sequence[Member], number: int = 0) -> None:
        """Make them. Raises Crash."""
        self._members = list(members)
        self._number = number
        self._envs: list[gymnasium.Env[Any, Any]] = []
        for member in members:
            try:
                self._envs.append(member.open())
            except (Exception, SystemExit) as error:
                self.close()
                raise Crash(member.index, "", error) from error

    def spaces(self) -> list[dict[str, Any]]:
        """Descriptions of each one's spaces, as :mod:`envcraft.spaces` reads them."""
        return [
            {"observation": describe(env.observation_space), "action": describe(env.action_space)} for env in self._envs
        ]

    def attach(self, arrays: Arrays, same_step: bool) -> None:
        """Take the arrays; with `same_step`, a step that ends an episode also begins the next one."""
        self._arrays, self._same_step = arrays, same_step
        # Views are made once: making one takes as long as a trivial step.
        self._rows = [arrays.observations[member.index : member.index + 1] for member in self._members]

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None) -> list[Info]:
        """Reset those whose bit in ``resets`` is set; `seeds` are those of all members. Raises Crash."""
        infos: list[Info] = []
        arrays = self._arrays
        for at, (member, seed) in enumerate(zip(self._members, seeds, strict=True)):
            if arrays.resets[member.index]:
                index = member.index
                arrays.rewards[index], arrays.terminated[index], arrays.truncated[index] = 0.0, False, False
                self._reset(at, infos, seed=seed, options=options)
        arrays.current[self._number] = -1
        return infos

    def step(self) -> list[Info]:
        """Step each one with its action, or reset it where its bit in ``resets`` is set. Raises Crash."""
        infos: list[Info] = []
        arrays = self._arrays
        for at, (member, env) in enumerate(zip(self._members, self._envs, strict=True)):
            index = member.index
            if arrays.resets[index]:
                arrays.rewards[index], arrays.terminated[index], arrays.truncated[index] = 0.0, False, False
                self._reset(at, infos)
                continue
            arrays.current[self._number] = index
            try:
                # A copy, which the environment may keep or write into.
                observation, reward, terminated, truncated, info = env.step(arrays.actions[index].copy())
                arrays.rewards[index] = float(reward)
                arrays.terminated[index] = terminated
                arrays.truncated[index] = truncated
                if self._same_step and (terminated or truncated):
                    _put(arrays.finals[index : index + 1], observation)
                    _note(infos, index, True, info)
                    self._reset(at, infos)
                    continue
                _put(self._rows[at], observation)
                _note(infos, index, False, info)
            except (Exception, SystemExit) as error:
                raise error if isinstance(error, Crash) else Crash(index, "step()", error) from error
        arrays.current[self._number] = -1
        return infos

    def render(self) -> list[Any]:
        """What each one's render() gives. Raises Crash."""
        frames = []
        for member, env in zip(self._members, self._envs, strict=True):
            self._arrays.current[self._number] = member.index
            try:
                frames.append(env.render())
            except (Exception, SystemExit) as error:
                raise Crash(member.index, "render()", error) from error
        self._arrays.current[self._number] = -1
        return frames

    def close(self) -> None:
        """Close them, whatever that raises."""
        for env in self._envs:
            with contextlib.suppress(Exception, SystemExit):
                env.close()
        self._envs.clear()

    def _reset(self, at: int, infos: list[Info], **keywords: Any) -> None:
        index = self._members[at].index
        self._arrays.current[self._number] = index
        try:
            observation, info = self._envs[at].reset(**keywords)
            _put(self._rows[at], observation)
            _note(infos, index, False, info)
        except (Exception, SystemExit) as error:
            raise Crash(index, "reset()", error) from error


def _note(infos: list[Info], index: int, final: bool, info: Any) -> None:
    """Keep an info, unless it says nothing. Raises TypeError."""
    if not isinstance(info, dict):
        raise TypeError(f"info is of type {type(info).__name__}, no dict")
    if info or final:
        infos.append((index, final, info))


def _put(row: NDArray[Any], observation: Any) -> None:
    """Write an observation into its row, which is kept as an array of one. Raises ValueError where it does not fit."""
    if np.shape(observation) != row.shape[1:]:
        raise ValueError(f"an observation of shape {np.shape(observation)}, where the space has {row.shape[1:]}")
    np.copyto(row, observation, casting="same_kind")
