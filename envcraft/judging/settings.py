"""What a verdict depends on besides the source: two verdicts under the same settings are the same verdict."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
from collections.abc import Iterable
from typing import Any

import msgspec

from envcraft.judging.budget import Budget
from envcraft.judging.check import Check
from envcraft.judging.code_digest import code_digest
from envcraft.judging.driver import Driver
from envcraft.model.contract import Contract
from envcraft.model.verdict import plain
from envcraft.registry import offered
from envcraft.version import __version__

#: What the environments of the built-in contracts import, and so what their episodes may depend on.
_LIBRARIES = ("numpy", "gymnasium", "pygame-ce", "scipy")

#: What is known of settings and does not tell them apart.
_BESIDE = ("checks", "offered")
#: What settings are called in words, where it is not as in the table.
_WORDS = {"contract_sha256": "a contract whose digest is", "image": "image or libraries"}


class Settings(msgspec.Struct, frozen=True):
    """A way to judge.

    Attributes:
        contract: the contract's name.
        contract_sha256: the digest of all that the contract promises.
        rules: the version of the rules (:func:`rules_version`).
        seed: of the run.
        budget: its name; its numbers are part of `rules`.
        driver: the sandbox driver's name.
        image: the digest of the image that workers run in, else the versions of the interpreter and the libraries.
        checks: the names of those that ran, empty where just those did that run unasked, ``?`` where that is not known.
        offered: what `rules` would be with all checks that run unasked, where some of them ran and no others; else
            empty.

    The last two are no part of what tells settings apart: `rules` has a digest of the checks that ran.
    """

    contract: str
    contract_sha256: str
    rules: str
    seed: int
    budget: str
    driver: str
    image: str
    checks: str = ""
    offered: str = ""

    @property
    def digest(self) -> str:
        return hashlib.sha256(msgspec.json.encode(self._telling())).hexdigest()

    def differing(self, other: Settings) -> list[str]:
        """In words, each setting that is not as in `other`, with both values."""
        told = other._telling()
        pairs = [(name, mine, told[name]) for name, mine in self._telling().items()]
        return [f"{_WORDS.get(name, name)} {mine}, not {theirs}" for name, mine, theirs in pairs if mine != theirs]

    def _telling(self) -> dict[str, Any]:
        """What tells settings apart."""
        return {name: value for name, value in msgspec.structs.asdict(self).items() if name not in _BESIDE}


def settings_of(contract: Contract, checks: Iterable[Check], driver: Driver, budget: Budget, seed: int) -> Settings:
    """The settings of a run. Raises SandboxUnavailable where the driver's image is missing."""
    checks, offers = list(checks), [check for check in offered("envcraft_checks") if not check.opt_in]
    names, offered_names = {check.name for check in checks}, {check.name for check in offers}
    return Settings(
        contract.name,
        contract_digest(contract),
        rules_version(checks, driver),
        seed,
        budget.name,
        driver.name,
        driver.image() or _libraries(),
        "" if names == offered_names else ",".join(sorted(names)),
        rules_version(offers, driver) if names < offered_names else "",
    )


def contract_digest(contract: Contract) -> str:
    """The SHA-256 of all that a contract promises; what it is called in listings is no part of it."""
    promises = msgspec.structs.replace(contract, summary="")
    return hashlib.sha256(msgspec.json.encode(plain(promises), order="sorted")).hexdigest()


def rules_version(checks: Iterable[Check], driver: Driver) -> str:
    """Give EnvCraft's version and a digest of the rules of these checks and of the code that judges.

    That code is the engine, the checks and the driver's package, each with all that it imports of EnvCraft
    (:mod:`envcraft.judging.code_digest`).
    """
    checks = sorted(checks, key=lambda check: check.name)
    rules = [(check.name, plain(list(check.rules))) for check in checks]
    digest = hashlib.sha256(msgspec.json.encode(rules, order="sorted"))
    digest.update(code_digest([*map(type, checks), type(driver)], driver.packages))
    return f"{__version__}+{digest.hexdigest()[:16]}"


def _libraries() -> str:
    words = [f"python {platform.python_version()}"]
    for name in _LIBRARIES:
        try:
            words.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    return ", ".join(words)
