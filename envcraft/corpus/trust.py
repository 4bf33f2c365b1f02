"""Whether an environment has passed, which ``envcraft.make`` and ``envcraft export`` require.

A pass counts if all offered checks ran and none ran out of time, and if the same source and class did not fail the same
checks in the same version, or some of them alone, under the same contract: another budget or seed does not revoke a
finding.
"""

from __future__ import annotations

from typing import NamedTuple

from envcraft.corpus.store import Store, verdicts
from envcraft.corpus.store.verdicts import Given
from envcraft.model.verdict import Verdict


class LastVerdict(NamedTuple):
    """The last verdict under a contract.

    Attributes:
        contract_sha256: the digest of the contract.
        verdict: the verdict.
        doubt: why it is not a pass that counts, as a predicate of the environment; empty if it is one.
        report: the verdict as JSON.
    """

    contract_sha256: str
    verdict: Verdict
    doubt: str
    report: str


def last_verdicts(store: Store, source: str, env_class: str) -> dict[str, LastVerdict]:
    """The last verdict on a source and class under each contract, by the contract's name, the newest first.

    Errors do not count.
    """
    last: dict[str, LastVerdict] = {}
    for given in verdicts.given(store, source, env_class):
        if given.verdict is not Verdict.ERROR and given.settings.contract not in last:
            found = LastVerdict(given.settings.contract_sha256, given.verdict, _doubt(given), given.report)
            last[given.settings.contract] = found
    return last


def contract_of(last: dict[str, LastVerdict]) -> str | None:
    """The contract that an environment has passed, else the one of its last verdict; None if it has no verdict."""
    return next((contract for contract, found in last.items() if not found.doubt), next(iter(last), None))


def _doubt(given: Given) -> str:
    if given.verdict is not Verdict.PASS:
        return f"has the verdict {given.verdict.value}"
    if not given.settled:
        return "has passed, but ran out of time, so some checks are not settled"
    if given.settings.checks:
        unknown = given.settings.checks == "?"
        return "has passed unknown checks" if unknown else "has passed only some of the checks"
    failed = "has passed, but failed the same checks with another budget or seed, or some of them alone,"
    return failed if given.failed else ""
