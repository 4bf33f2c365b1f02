"""Which findings count: severities of a project, ``--strict``, and comments that ignore findings in the author's file.

Only commands for authors apply them, such as ``envcraft validate``. Verdicts that others rely on, as those of audits
and of generation, depend on none of them.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from envcraft.config import settings
from envcraft.errors import UsageError
from envcraft.judging.check import Check
from envcraft.judging.selection import all_checks, like_a_rule
from envcraft.model.verdict import Finding, Severity

#: The value of a setting that leaves findings out.
OFF = "off"
_VALUES = (*(severity.value for severity in Severity), OFF)


class SeverityPolicy(msgspec.Struct, frozen=True):
    """How the findings of a run count.

    Attributes:
        table: ``error``, ``warning`` or ``off`` by code, or by the name of a check for all of its codes.
        strict: whether every warning is an error, and a check that leaves its question open fails.
        comments: whether the run is an author's: comments in the target's file can ignore findings, and an error of
            the privileged policy is wrong use.
        select: the rules that report, by codes or their first characters; () for those that do by default. Gates, and
            checks that always run, report in any case.
        ignore: the rules that do not report, by codes or their first characters, except those that must stay errors.
        baseline: the fingerprints of findings that do not count (:func:`envcraft.model.identity.fingerprint`), unless
            they must stay errors.
    """

    table: dict[str, str] = {}
    strict: bool = False
    comments: bool = False
    select: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    baseline: frozenset[str] = frozenset()

    def reports(self, check: Check, code: str) -> bool:
        """Whether a rule is selected; without ``--select``, whether it reports by default or has a severity."""
        if self.select and not (check.gate or check.always or check.stops(code)):
            return code.startswith(self.select)
        return code in self.table or all(rule.default for rule in check.rules if rule.code == code)

    def apply(self, check: Check, finding: Finding) -> Finding | None:
        """Return a finding with the severity that it has under this policy; None if it is left out."""
        if not self.reports(check, finding.code):
            return None
        if self.ignore and finding.code.startswith(self.ignore) and check.waivable(finding.code):
            return None
        value = self.table.get(finding.code, self.table.get(check.name))
        if value is None or (value != Severity.ERROR and not check.waivable(finding.code)):
            value = finding.severity.value
        if value == OFF:
            return None
        severity = Severity.ERROR if self.strict else Severity(value)
        return finding if severity is finding.severity else msgspec.structs.replace(finding, severity=severity)

    def shows(self, check: Check, finding: Finding) -> bool:
        """Whether a finding shows a defect that other rules need not report: an error, or what the table makes one.

        An error that is ignored or off shows it, too; one of a rule that is not selected does not.
        """
        if not self.reports(check, finding.code):
            return False
        counted = self.apply(check, finding)
        chosen = not self.table.keys().isdisjoint((finding.code, check.name))
        return (counted or finding).severity is Severity.ERROR or (counted is not None and chosen)


def severity_table(folder: Path) -> dict[str, str]:
    """Read ``[tool.envcraft.severity]`` of the ``pyproject.toml`` in `folder`, or of the nearest one above.

    Args:
        folder: where the search for the file starts.

    Raises:
        UsageError: a name or a value does not exist, or a code or check must stay an error.
    """
    path, every = settings(folder)
    if not (table := every.get("severity", {})):
        return {}
    place = f"{path}: [tool.envcraft.severity]"
    if not isinstance(table, dict):
        raise UsageError(f'{place} must be a table, such as EC209 = "error"')
    families = {check.name: check for check in all_checks()}
    owners = {rule.code: check for check in families.values() for rule in check.rules}
    for name, value in table.items():
        if name not in owners and name not in families:
            raise UsageError(f"{place}: there is no rule or check {like_a_rule(name, [*families.values()], families)}")
        if value not in _VALUES:
            raise UsageError(f"{place}: {name} is {value!r}; it must be {', '.join(_VALUES[:-1])} or {OFF}")
        owner = owners.get(name)
        stays = families[name].gate or families[name].always if owner is None else not owner.waivable(name)
        if value != Severity.ERROR and stays:
            raise UsageError(f"{place}: {name} must stay an error, because other verdicts depend on it")
    return dict(table)
