"""Look up contracts of plugins and of the nearest ``pyproject.toml``."""

from __future__ import annotations

from pathlib import Path

from envcraft.contracts.builtin import envcraft_contracts
from envcraft.contracts.custom import custom_contracts, refuse_taken, valid_contract
from envcraft.judging.selection import all_checks
from envcraft.model.contract import Contract
from envcraft.registry import lookup, offered


def all_contracts() -> list[Contract]:
    """The plugins' contracts, and those of the nearest pyproject.toml. Raises UsageError if one is not valid."""
    found = [valid_contract(contract) for contract in offered("envcraft_contracts")]
    return found + custom_contracts(
        Path.cwd(), found, lambda: (rule.code for check in all_checks() for rule in check.rules)
    )


def contract_named(name: str) -> Contract:
    """The contract with this name; a built-in one is found without importing any plugin.

    Raises:
        UsageError: There is none; the message names the nearest. Or pyproject.toml gives its name to another.
    """
    for contract in envcraft_contracts():
        if contract.name == name:
            refuse_taken(Path.cwd(), [name])
            return contract
    found: Contract = lookup("contract", name, {contract.name: contract for contract in all_contracts()})
    return found
