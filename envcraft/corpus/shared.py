"""Codes that nearly all environments of a corpus have: a property of the corpus, which a contract can waive."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from envcraft.judging.check import Check
from envcraft.text import one_line, plural

#: The share of the environments from which on a code is one of the corpus, and the fewest of them.
_NEARLY_ALL, _FEWEST = 0.8, 10


class Shared(msgspec.Struct, frozen=True):
    """A code that nearly all environments have.

    Attributes:
        code: of the rule.
        environments: that have it.
        judged: the environments with a verdict.
        waiver: the setting of a contract that waives it; "" if other verdicts depend on it.
    """

    code: str
    environments: int
    judged: int
    waiver: str

    @property
    def words(self) -> str:
        """One sentence for people."""
        share = f"{self.code} in {self.environments / self.judged:.0%} of {plural(self.judged, 'environment')}"
        means = f"if this is intended, waive it in a contract with {self.waiver}"
        return one_line(f"{share}: {means if self.waiver else 'they probably have one cause'}")


def shared_codes(counts: Mapping[str, int], judged: int, checks: list[Check]) -> list[Shared]:
    """Return the codes that nearly all environments have, the most frequent first.

    Args:
        counts: the number of environments with each code, the most frequent first.
        judged: the number of environments with a verdict.
        checks: all checks.
    """
    if judged < _FEWEST:
        return []
    owners = {rule.code: (rule, check) for check in checks for rule in check.rules}
    found = []
    for code, number in counts.items():
        if number < _NEARLY_ALL * judged:
            continue
        waiver = ""
        if code in owners and owners[code][1].waivable(code):
            waiver = owners[code][0].waiver or f'without = ["{code}"]'
        found.append(Shared(code, number, judged, waiver))
    return found
