"""``python -m benchmarks.third_party``: judge what others have published, and write ``docs/third-party.md``.

Each environment is judged under the contract ``gymnasium``, one at a time. What was made of each finding is written
down in ``benchmarks/third_party.toml``: a finding without such a note makes the command fail, and so does a note whose
finding is gone. Results are kept in ``build/third-party.json``, so that a run that was interrupted goes on; ``--again``
judges everything anew, and a part of a target's name only what matches. The page says how many rows are of an earlier
state of the code than the one that wrote it.
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

from envcraft.budget import BUDGETS
from envcraft.commands.choices import contract_named, default_checks, driver_named
from envcraft.engine import Plan, validate
from envcraft.events import Finished
from envcraft.sandbox import Limits
from envcraft.target import Kind, Target, kind_of
from envcraft.verdict import SubjectReport, plain

ROOT = Path(__file__).resolve().parent.parent
_NOTES = ROOT / "benchmarks" / "third_party.toml"
_KEPT = ROOT / "build" / "third-party.json"
_PAGE = ROOT / "docs" / "third-party.md"
_LIMITS = Limits(loading=30.0, job=120.0, total=600.0)
_HEAD = """# Environments of others

What EnvCraft says of environments that others have published, under the contract `gymnasium` with the budget `quick`
and seed 0. Written by `python -m benchmarks.third_party`. Each finding was read beside the package's source; what came
of that is in the last column, and below, with a reproduction that needs no EnvCraft, where the package's authors should
hear of it.

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
    """Of everything that a verdict depends on."""
    digest = hashlib.sha256()
    for folder in ("envcraft", "checks", "sandbox"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def judge(name: str, kwargs: dict[str, Any]) -> SubjectReport:
    """The report of one environment."""
    target = Target(name, kind=kind_of(name) or Kind.ID, kwargs=kwargs)
    with contextlib.closing(driver_named("bubblewrap")) as driver:
        plan = Plan([target], contract_named("gymnasium"), driver, default_checks(), BUDGETS["quick"], limits=_LIMITS)
        last = list(validate(plan, 1))[-1]
    assert isinstance(last, Finished)
    return last.report.reports[0]


def codes(report: dict[str, Any]) -> list[str]:
    return [finding["code"] for check in report["checks"] for finding in check["findings"]]


def unread(notes: dict[str, Any], kept: dict[str, Any]) -> list[str]:
    """Findings that nobody has judged, and notes on what is no finding any more."""
    listed = {name for package in notes["package"] for name in package["targets"]}
    found = {(name, code) for name, report in kept.items() if name in listed for code in codes(report)}
    read = {(name, note["code"]) for note in notes["note"] for name in note["targets"]}
    return [f"{name} {code}: not judged yet" for name, code in sorted(found - read)] + [
        f"{name} {code}: no such finding any more" for name, code in sorted(read - found)
    ]


def page(notes: dict[str, Any], kept: dict[str, Any]) -> str:
    judged = {(name, note["code"]): note for note in notes["note"] for name in note["targets"]}
    listed = [name for package in notes["package"] for name in package["targets"]]
    now = code_digest()
    stale = sum(kept[name].get("code") != now for name in listed if name in kept)
    note = f"{stale} of {len(listed)} rows were made by an earlier state of the code; `--again` judges all anew.\n\n"
    heads = ("package", "environment", "verdict", "checks that were skipped", "findings", "judged")
    lines = [_HEAD, note if stale else "", _row(heads), _row(["---"] * len(heads))]
    for package in notes["package"]:
        title = f"{package['name']} {importlib.metadata.version(package['name'])}"
        for name in package["targets"]:
            report = kept.get(name)
            if report is None:
                continue
            reason = f" ({report['reason']})" if report["reason"] else ""
            told = [(code, judged.get((name, code), {"verdict": "not judged yet"})) for code in codes(report)]
            verdicts = "; ".join(f"{code} {note['verdict']}" for code, note in told)
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
