"""Contracts: the interface that an environment promises, as data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec

if TYPE_CHECKING:
    from envcraft_protocol import jobs

#: The value of `Contract.render` that requires no ``render()``, but checks the pictures of one that exists.
OPTIONAL: Final = "optional"


class Success(msgspec.Struct, frozen=True):
    """How a win is defined: by `key` of the last info if present; otherwise, with `sign`, by a positive return."""

    key: str = "is_success"
    sign: bool = True


class Contract(msgspec.Struct, frozen=True, kw_only=True):
    """What an environment promises.

    Attributes:
        name: the name for ``--contract``.
        summary: one line for ``envcraft contracts``.
        observation: JSON description of the observation space; None allows any space.
        action: JSON description of the action space; None allows any space.
        limit: steps after which every episode must have ended, or None.
        reward_range: the lowest and highest reward of one step, in the environment's own units.
        noop: the action that does nothing, or None.
        render: whether ``render()`` must return the observation. ``"optional"``: only if there is one, even
            if the metadata say otherwise.
        libraries: modules that an environment may import besides the standard library; None allows all installed.
        project: whether an environment may import the files of its project, which are its package and the files beside
            it. Otherwise it must be one file.
        adapter: wrappers that the worker applies: ``{"resize": [height, width], "limit": steps}``.
        success: how a win is defined.
        without: codes of rules that do not apply.
        consistently: the share of episodes above which a player wins "consistently".
        min_steps_per_second: fewer steps a second of processor time are too slow to train on.
        at_once: a loss within this many steps counts as a loss at once.
    """

    name: str
    summary: str
    observation: dict[str, Any] | None = None
    action: dict[str, Any] | None = None
    limit: int | None = None
    reward_range: tuple[float, float] = (float("-inf"), float("inf"))
    noop: Any = None
    render: bool | Literal["optional"] = False
    libraries: tuple[str, ...] | None = None
    project: bool = False
    adapter: dict[str, Any] = {}
    success: Success = Success()
    without: tuple[str, ...] = ()
    consistently: float = 0.8
    min_steps_per_second: float = 20.0
    at_once: int = 30

    def for_worker(self) -> jobs.Contract:
        """The fields that the worker needs, as JSON."""
        return {
            "action": self.action,
            "adapter": self.adapter,
            "success": self.success.key,
            "sign": self.success.sign,
        }
