"""The built-in contracts: ``arcade``, ``arcade-native`` and ``gymnasium``."""

from __future__ import annotations

import msgspec

from envcraft.model.contract import OPTIONAL, Contract, Success
from envcraft.plugins import hookimpl

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
    summary="the same game rules, frames of any size, no step limit, and render() optional: adapted to arcade",
    # Observations are frames already, so render() adds nothing.
    render=OPTIONAL,
    adapter={"resize": [84, 84], "limit": 1000},
)


GYMNASIUM = Contract(
    name="gymnasium",
    summary="all of Gymnasium's spaces, any length; the rules on the API, determinism and finite rewards still apply",
    # The sign of a return means nothing if rewards have any size.
    success=Success(sign=False),
    project=True,
    # One fixed level is fine, and Gymnasium leaves the steps after an end undefined.
    without=("EC209", "EC505"),
)


@hookimpl
def envcraft_contracts() -> list[Contract]:
    return [ARCADE, ARCADE_NATIVE, GYMNASIUM]
