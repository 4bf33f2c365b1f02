"""``python -m benchmarks.third_party``: judge published environments and write ``docs/third-party.md``.

Each environment is judged alone under the contract ``gymnasium``. ``benchmarks/third_party.toml`` has a note on each
finding; the command fails if a finding has no note, or a note has no finding. Results are kept in
``build/third-party.json``, so an interrupted run continues. ``--again`` judges all environments again, and a part of a
name only those that match. The page states how many rows come from an earlier version of the code.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import json
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from envcraft.contracts.lookup import contract_named
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Limits
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks, driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Kind, Target, kind_of
from envcraft.model.verdict import SubjectReport, plain

ROOT = Path(__file__).resolve().parent.parent
_NOTES = ROOT / "benchmarks" / "third_party.toml"
_KEPT = ROOT / "build" / "third-party.json"
_PAGE = ROOT / "docs" / "third-party.md"
_LIMITS = Limits(loading=30.0, job=120.0)
_SECONDS = 600.0
_HEAD = """# Third-party environments

This page lists the verdicts of EnvCraft on published environments, under the contract `gymnasium` with the budget
`quick` and seed 0. `python -m benchmarks.third_party` writes it. Each finding was compared with the source of the
package; the last column has the result. If the authors of the package should know about a finding, a reproduction
below shows it without EnvCraft.

"""


def main(arguments: list[str]) -> int:
    notes = tomllib.loads(_NOTES.read_text("utf-8"))
    kept: dict[str, Any] = json.loads(_KEPT.read_text("utf-8")) if _KEPT.is_file() else {}
    wanted = [word for word in arguments if not word.startswith("--")]
    for package in notes["package"]:
        for name in package["targets"]:
            chosen = any(word in name for word in wanted) if wanted else "--again" in arguments
            if chosen or (name not in kept and not wanted):
                kept[name] = {**plain(judge(name, package.get("kwargs", {}))), "code": code_digest()}
                _KEPT.parent.mkdir(exist_ok=True)
                _KEPT.write_text(json.dumps(kept, indent=1), "utf-8")
                print(name, kept[name]["verdict"], codes(kept[name]), f"{kept[name]['seconds']:.0f} s", flush=True)
    _PAGE.write_text(page(notes, kept), "utf-8")
    wrong = unread(notes, kept)
    for line in wrong:
        print(line, file=sys.stderr)
    return int(bool(wrong))


def code_digest() -> str:
    """The digest of all code that a verdict can depend on."""
    digest = hashlib.sha256()
    for folder in ("envcraft", "checks", "sandbox"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def judge(name: str, kwargs: dict[str, Any]) -> SubjectReport:
    """The report of one environment."""
    target = Target(name, kind=kind_of(name) or Kind.ID, kwargs=kwargs)
    with contextlib.closing(driver_named("bubblewrap")) as driver:
        plan = Plan(
            [target],
            contract_named("gymnasium"),
            driver,
            default_checks(),
            BUDGETS["quick"],
            limits=_LIMITS,
            time_limit=_SECONDS,
        )
        last = list(validate(plan, 1))[-1]
    assert isinstance(last, Finished)
    return last.report.reports[0]


def codes(report: dict[str, Any]) -> list[str]:
    return [finding["code"] for check in report["checks"] for finding in check["findings"]]


def unread(notes: dict[str, Any], kept: dict[str, Any]) -> list[str]:
    """Findings without a note, and notes without a finding."""
    listed = {name for package in notes["package"] for name in package["targets"]}
    found = {(name, code) for name, report in kept.items() if name in listed for code in codes(report)}
    read = {(name, note["code"]) for note in notes["note"] for name in note["targets"]}
    return [f"{name} {code}: not reviewed" for name, code in sorted(found - read)] + [
        f"{name} {code}: the note has no finding" for name, code in sorted(read - found)
    ]


def page(notes: dict[str, Any], kept: dict[str, Any]) -> str:
    judged = {(name, note["code"]): note for note in notes["note"] for name in note["targets"]}
    listed = [name for package in notes["package"] for name in package["targets"]]
    now = code_digest()
    stale = sum(kept[name].get("code") != now for name in listed if name in kept)
    note = f"{stale} of {len(listed)} rows are from an earlier version of the code; `--again` judges all of them.\n\n"
    heads = ("package", "environment", "verdict", "skipped checks", "findings", "review")
    lines = [_HEAD, note if stale else "", _row(heads), _row(["---"] * len(heads))]
    for package in notes["package"]:
        title = f"{package['name']} {importlib.metadata.version(package['name'])}"
        for name in package["targets"]:
            report = kept.get(name)
            if report is None:
                continue
            reason = f" ({report['reason']})" if report["reason"] else ""
            reviewed = [(code, judged.get((name, code), {"verdict": "not reviewed"})) for code in codes(report)]
            verdicts = "; ".join(f"{code} {note['verdict']}" for code, note in reviewed)
            skipped = [check["check"] for check in report["checks"] if check["verdict"] == "skip"]
            blocked = "all but source" if len(skipped) > 6 else ", ".join(skipped)
            verdict = f"{report['verdict']}{reason}"
            lines.append(_row((title, f"`{name}`", verdict, blocked, ", ".join(codes(report)), verdicts)))
            title = ""
    lines.append("\n## Findings\n")
    for note in notes["note"]:
        lines.append(f"\n### {note['code']}: {note['title']}\n\n")
        lines.append(", ".join(f"`{name}`" for name in note["targets"]) + f" · {note['verdict']}\n\n")
        lines += [
            f"> {finding['message']}\n\n"
            for check in kept.get(note["targets"][0], {"checks": []})["checks"]
            for finding in check["findings"]
            if finding["code"] == note["code"]
        ]
        lines.append(note["what"].strip() + "\n")
        if "reproduction" in note:
            lines.append(f"\n```python\n{note['reproduction'].strip()}\n```\n")
    return "".join(lines)


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
