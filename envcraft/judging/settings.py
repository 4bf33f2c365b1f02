"""What a verdict depends on besides the source. The same source under the same settings has the same verdict."""

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
from envcraft.model.target import PolicyFile
from envcraft.model.verdict import plain
from envcraft.registry import offered
from envcraft.version import __version__

#: The libraries that environments of the built-in contracts import, so that their episodes may depend on them.
_LIBRARIES = ("numpy", "gymnasium", "pygame-ce", "scipy")

#: Fields that are not part of the identity of settings.
_DESCRIPTIVE = ("checks", "offered")
#: Names of fields in messages, if they differ from the field's name.
_WORDS = {"contract_sha256": "a contract whose digest is", "image": "image or libraries"}


#: Fields that contracts have had only since corpora were made, with their defaults: these corpora stay usable.
_LATER = {"min_steps_per_second": 20.0, "project": False}


class Settings(msgspec.Struct, frozen=True):
    """The settings of a verdict.

    `checks` and `offered` are not part of the identity, because `rules` includes a digest of the checks that ran.

    Attributes:
        contract: the contract's name.
        contract_sha256: the digest of the contract.
        rules: the version of the rules (:func:`rules_version`).
        seed: of the run.
        budget: the budget's name; its numbers are part of `rules`.
        driver: the sandbox driver's name.
        image: the digest of the workers' image, or the versions of the interpreter and the libraries.
        checks: the names of the checks that ran, comma-separated. Empty if they are the default checks, ``?`` if that
            is unknown.
        offered: `rules` as computed with all default checks, if a proper subset of them ran. Otherwise empty.
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
        return hashlib.sha256(msgspec.json.encode(self._identity())).hexdigest()

    def differing(self, other: Settings) -> list[str]:
        """Return a phrase for each setting that differs from `other`, with both values."""
        expected = other._identity()
        pairs = [(name, mine, expected[name]) for name, mine in self._identity().items()]
        return [f"{_WORDS.get(name, name)} {mine}, not {theirs}" for name, mine, theirs in pairs if mine != theirs]

    def _identity(self) -> dict[str, Any]:
        return {name: value for name, value in msgspec.structs.asdict(self).items() if name not in _DESCRIPTIVE}


def settings_of(
    contract: Contract,
    checks: Iterable[Check],
    driver: Driver,
    budget: Budget,
    seed: int,
    policy: PolicyFile | None = None,
) -> Settings:
    """Return the settings of a run.

    Raises:
        SandboxUnavailable: the driver's image is missing.
    """
    checks, offers = list(checks), [check for check in offered("envcraft_checks") if not check.opt_in]
    names, offered_names = {check.name for check in checks}, {check.name for check in offers}
    return Settings(
        contract.name,
        contract_digest(contract),
        rules_version(checks, driver, policy),
        seed,
        budget.name,
        driver.name,
        driver.image() or _libraries(),
        "" if names == offered_names else ",".join(sorted(names)),
        rules_version(offers, driver, policy) if names < offered_names else "",
    )


def contract_digest(contract: Contract) -> str:
    """Return the SHA-256 of a contract without its summary, and without later fields that are at their defaults."""
    promises = plain(msgspec.structs.replace(contract, summary=""))
    for name, default in _LATER.items():
        if promises[name] == default:
            del promises[name]
    return hashlib.sha256(msgspec.json.encode(promises, order="sorted")).hexdigest()


def rules_version(checks: Iterable[Check], driver: Driver, policy: PolicyFile | None = None) -> str:
    """Return EnvCraft's version with a digest of the checks' rules and of the code that judges.

    The text of the privileged policy is part of the digest, if there is one.
    That code consists of the engine, the checks and the driver's package, each with all modules of EnvCraft that it
    imports (:mod:`envcraft.judging.code_digest`).
    """
    checks = sorted(checks, key=lambda check: check.name)
    rules = [(check.name, plain(list(check.rules))) for check in checks]
    digest = hashlib.sha256(msgspec.json.encode(rules, order="sorted"))
    digest.update(code_digest([*map(type, checks), type(driver)], driver.packages))
    if policy is not None:
        digest.update(policy.source.encode("utf-8", "surrogatepass"))
    return f"{__version__}+{digest.hexdigest()[:16]}"


def _libraries() -> str:
    words = [f"python {platform.python_version()}"]
    for name in _LIBRARIES:
        try:
            words.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    return ", ".join(words)
