"""Contracts: the interface that an environment promises, as data plus the adapter that the worker applies."""

from __future__ import annotations

from typing import Any

import msgspec

from envcraft.plugins import hookimpl


class Success(msgspec.Struct, frozen=True):
    """What winning is: `key` of the last info where it is there; else, with `sign`, a positive return at the end."""

    key: str = "is_success"
    sign: bool = True


class Contract(msgspec.Struct, frozen=True, kw_only=True):
    """What an environment promises.

    Attributes:
        name: how ``--contract`` names it.
        summary: one line for ``envcraft contracts``.
        observation: JSON description of the observation space, or None where any space will do.
        action: JSON description of the action space, or None where any space will do.
        limit: the step by which every episode has ended, or None.
        reward_range: the lowest and highest reward of one step, in the environment's own units.
        noop: the action that does nothing, or None where the contract knows none.
        render: whether ``render()`` must give the observation.
        libraries: what an environment may import besides the standard library, or None for whatever is installed.
        adapter: wrappers that the worker applies: ``{"resize": [height, width], "limit": steps}``.
        success: what winning is.
        without: codes that the contract does not hold an environment to.
        consistently: the share of episodes above which a player wins "consistently".
        at_once: losing within this many steps is losing at once.
    """

    name: str
    summary: str
    observation: dict[str, Any] | None = None
    action: dict[str, Any] | None = None
    limit: int | None = None
    reward_range: tuple[float, float] = (float("-inf"), float("inf"))
    noop: Any = None
    render: bool = False
    libraries: tuple[str, ...] | None = None
    adapter: dict[str, Any] = {}
    success: Success = Success()
    without: tuple[str, ...] = ()
    consistently: float = 0.8
    at_once: int = 30

    def for_worker(self) -> dict[str, Any]:
        """The part that the worker needs."""
        return {
            "action": self.action,
            "adapter": self.adapter,
            "success": self.success.key,
            "sign": self.success.sign,
        }


_FRAME = {"type": "Box", "low": 0, "high": 255, "shape": [84, 84, 3], "dtype": "uint8"}
_PAD = {"type": "MultiDiscrete", "nvec": [5, 2, 2], "start": [0, 0, 0], "dtype": "int64"}

ARCADE = Contract(
    name="arcade",
    summary="84x84 RGB frames, a pad with five moves and two buttons, at most 1,000 steps (default)",
    observation=_FRAME,
    action=_PAD,
    limit=1000,
    reward_range=(-100.0, 100.0),
    noop=[0, 0, 0],
    render=True,
    # Gymnasium itself needs typing_extensions.
    libraries=("numpy", "gymnasium", "pygame", "scipy", "typing_extensions"),
)

ARCADE_NATIVE = msgspec.structs.replace(
    ARCADE,
    name="arcade-native",
    summary="the same game rules, frames of any size and no step limit: adapted to arcade by area resize and a limit",
    adapter={"resize": [84, 84], "limit": 1000},
)

GYMNASIUM = Contract(
    name="gymnasium",
    summary="any spaces that Gymnasium has, any length; API, determinism and finite rewards still hold",
    # The sign of a return means nothing where rewards may be of any size.
    success=Success(sign=False),
    # One fixed level is as good as any, and what comes after the end is undefined.
    without=("EC209", "EC505"),
)


@hookimpl
def envcraft_contracts() -> list[Contract]:
    return [ARCADE, ARCADE_NATIVE, GYMNASIUM]
