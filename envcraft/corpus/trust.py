"""Whether an environment has passed: what ``envcraft.make`` and ``envcraft export`` go by.

A pass counts where all checks ran that were offered, and where the same source and class was not found to fail by the
same checks in the same version, or by some of them alone, under the same contract: another budget or seed takes no
finding back.
"""

from __future__ import annotations

from typing import NamedTuple

from envcraft.corpus.store import Store
from envcraft.verdict import Verdict

_FAILED = (
    "EXISTS (SELECT 1 FROM verdicts AS v JOIN settings AS s ON s.id = v.settings WHERE v.source = verdicts.source "
    "AND v.class = verdicts.class AND v.verdict = 'fail' AND s.contract_sha256 = settings.contract_sha256 "
    "AND settings.rules IN (s.rules, s.offered))"
)
#: The condition on a row of ``verdicts`` with its ``settings``, the last on an environment, that this has passed.
PASSED = f"(verdicts.verdict = 'pass' AND settings.checks = '' AND NOT {_FAILED})"


class Last(NamedTuple):
    """The last verdict under a contract; `doubt` says in words why it is no pass that counts, empty where it is."""

    contract_sha256: str
    verdict: Verdict
    doubt: str
    report: str


def last_verdicts(store: Store, source: str, env_class: str) -> dict[str, Last]:
    """The last verdict on a source and class under each contract by its name, the newest first; what could not be
    judged says nothing.
    """
    rows = store.db.execute(
        f"SELECT contract, contract_sha256, verdict, checks, {_FAILED}, report FROM verdicts JOIN settings "
        "ON settings.id = verdicts.settings WHERE source = ? AND class = ? AND verdict != 'error' "
        # The environment's own is the last one, also where an older row was written again.
        "ORDER BY verdicts.id IN (SELECT verdict FROM environments WHERE source = ? AND class = ?) DESC, "
        "verdicts.id DESC",
        (source, env_class, source, env_class),
    )
    last: dict[str, Last] = {}
    for contract, digest, verdict, checks, failed, report in rows:
        given = Verdict(verdict)
        last.setdefault(contract, Last(digest, given, _doubt(given, checks, failed), report))
    return last


def contract_of(last: dict[str, Last]) -> str | None:
    """Of the last verdicts on an environment, the contract that it has passed, else the one that it was judged under
    last; None where it was not judged.
    """
    return next((contract for contract, given in last.items() if not given.doubt), next(iter(last), None))


def _doubt(verdict: Verdict, checks: str, failed: int) -> str:
    if verdict is not Verdict.PASS:
        return f"has the verdict {verdict.value}"
    if checks:
        return "has passed checks that are not known" if checks == "?" else "has passed only some of the checks"
    words = "has passed, but failed by the same checks with another budget or seed, or by some of them alone,"
    return words if failed else ""
