"""Vector environments of variants without a corpus."""

from __future__ import annotations

from collections.abc import Sequence

from gymnasium.vector import AutoresetMode

from envcraft.environments.vector import NamedVectorEnv, autoreset_mode_named
from envcraft_tetris.variant import Variant
from envcraft_tetris.vectorized.simulator import Simulator


def make_vec(
    variants: Sequence[Variant],
    num_envs: int | None = None,
    *,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    copy: bool = True,
) -> NamedVectorEnv:
    """Make a vector environment whose environment `i` plays ``variants[i % len(variants)]``.

    Args:
        variants: The variants to simulate.
        num_envs: The number of environments; by default, one per variant.
        autoreset_mode: When an environment resets after its episode ends, as in :func:`envcraft.make_vec`.
        copy: Whether each step returns new observation arrays. Without copies they are read-only.

    Raises:
        UsageError: The mode does not exist, or numba is not installed.
    """
    count = len(variants) if num_envs is None else num_envs
    chosen = [variants[index % len(variants)] for index in range(count)]
    simulator = Simulator(chosen, autoreset_mode_named(autoreset_mode), copy)
    return NamedVectorEnv(simulator, [variant.title for variant in chosen])
