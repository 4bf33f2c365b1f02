"""Which contract fits an environment whose spaces are not those of the contract that was named."""

from __future__ import annotations

from envcraft.judging.description import Description
from envcraft.model.contract import Contract
from envcraft.registry import offered
from envcraft.spaces.spec import Box, SpaceSpec, read_space


def fitting_contract(description: Description, named: Contract) -> str | None:
    """Find a contract that promises the spaces of an environment.

    Args:
        description: what a worker reports under the contract `named`, whose adapter it has applied.
        named: the contract that the environment was judged under.

    Returns:
        The name of the contract that promises the most, None if no other contract fits.
    """
    given = description.get("observation_space"), description.get("action_space")
    if given[0] is None or given[1] is None:
        return None
    observation, action = read_space(given[0]), read_space(given[1])
    others: list[Contract] = [each for each in offered("envcraft_contracts") if each.name != named.name]
    others.sort(key=lambda each: (each.observation is None) + (each.action is None))
    return next((each.name for each in others if _fits(each, observation, action)), None)


def _fits(contract: Contract, observation: SpaceSpec, action: SpaceSpec) -> bool:
    return _promised(contract.action, action) and (
        _promised(contract.observation, observation) or ("resize" in (contract.adapter or {}) and _frame(observation))
    )


def _promised(promised: dict[str, object] | None, space: SpaceSpec) -> bool:
    return space.known if promised is None else read_space(promised) == space


def _frame(space: SpaceSpec) -> bool:
    """Whether a space has frames `(H, W, 3)` uint8, which an adapter resizes."""
    return (
        isinstance(space, Box)
        and space.dtype == "uint8"
        and len(space.shape) == 3
        and space.shape[2] == 3
        and space.spans_dtype
    )
