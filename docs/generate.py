"""``make docs``: write the rule pages with their index, the README's counts and study, the tables of the pages on
statistics and families, the results of the study, and the page on pytest from the plugin's docstring; with ``--check``
only compare.
"""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import TypeVar

import msgspec
from envcraft_dqn.study.report import headline, section, transfer_section
from envcraft_dqn.study.summary import Summary
from envcraft_dqn.study.transfer import TransferSummary
from envcraft_families.families import families

from envcraft import pytest_plugin
from envcraft.judging.check import Check
from envcraft.judging.guide import guide_file
from envcraft.plugins import plugins
from evaluation import characteristics
from evaluation.fixtures import fixtures

ROOT = Path(__file__).resolve().parent.parent
_Result = TypeVar("_Result")


def main() -> int:
    checks: list[Check] = plugins().collect("envcraft_checks")
    pages = {ROOT / "docs" / "rules" / f"{check.name}.md": page(check) for check in checks}
    pages[ROOT / "docs" / "rules" / "index.md"] = f"# Rules\n\n{counts(checks)}\n{table(checks)}"
    pages[ROOT / "docs" / "pytest.md"] = inspect.cleandoc(pytest_plugin.__doc__ or "") + "\n"
    study = committed("generalisation", Summary)
    blocks = {
        ROOT / "README.md": {"counts": counts(checks), "study": headline(study)},
        ROOT / "docs" / "families.md": {"families": family_table()},
        ROOT / "docs" / "study.md": {
            "results": section(study),
            "transfer": transfer_section(committed("transfer", TransferSummary)),
        },
        ROOT / "docs" / "statistics.md": {name: write() for name, write in characteristics.BLOCKS.items()},
    }
    for file, written in blocks.items():
        pages[file] = file.read_text("utf-8")
        for name, block in written.items():
            head, start, rest = pages[file].partition(f"<!-- {name} -->\n")
            _, end, tail = rest.partition(f"<!-- /{name} -->")
            if not end:
                print(f"{file.relative_to(ROOT)} has no block <!-- {name} -->", file=sys.stderr)
                return 1
            pages[file] = head + start + block + end + tail
    stale = [path for path, wanted in pages.items() if not path.is_file() or path.read_text("utf-8") != wanted]
    stale += [path for path in (ROOT / "docs" / "rules").glob("*.md") if path not in pages]
    if "--check" in sys.argv[1:]:
        for path in stale:
            print(f"{path.relative_to(ROOT)} is not up to date: run `make docs`", file=sys.stderr)
        return int(bool(stale))
    for path in stale:
        if path in pages:
            path.parent.mkdir(exist_ok=True)
            path.write_text(pages[path], "utf-8")
        else:
            path.unlink()
        print(f"wrote {path.relative_to(ROOT)}")
    return 0


def committed(name: str, kind: type[_Result]) -> _Result:
    """The committed results of a study."""
    return msgspec.json.decode((ROOT / "docs" / "results" / name / "summary.json").read_bytes(), type=kind)


def family_table() -> str:
    """The axes of the small families."""
    lines = ["| family | axis | values |", "|---|---|---|"]
    for family in families():
        for number, (axis, values) in enumerate(family.variant.axes.items()):
            lines.append(f"| {'' if number else family.name} | {axis} | {values} |")
    return "\n".join(lines) + "\n"


def page(check: Check) -> str:
    """A check's page: its module's docstring, and its rules."""
    rows = [
        f"| {linked(check, rule.code)} | `{rule.name}` | {rule.status} | {rule.summary} | {rule.fix} |"
        for rule in check.rules
    ]
    head = "| code | name | severity | problem | fix |\n|---|---|---|---|---|\n"
    return check.page.rstrip() + "\n\n## Rules\n" + head + "\n".join(rows) + "\n"


def linked(check: Check, code: str) -> str:
    """A code with a link to its guide, if it has one."""
    guide = guide_file(check, code)
    return (
        f"[{code}](../../{guide.relative_to(ROOT).as_posix()})"
        if guide.is_relative_to(ROOT) and guide.exists()
        else code
    )


def counts(checks: list[Check]) -> str:
    """The sentence on how many checks, rules and fixtures there are."""
    rules = sum(len(check.rules) for check in checks)
    every = fixtures()
    bad = sum(bool(fixture.codes) for fixture in every)
    return (
        f"EnvCraft has {len(checks)} checks with {rules} rules. "
        f"They are tested on {bad} defective and {len(every) - bad} correct environments.\n"
    )


def table(checks: list[Check]) -> str:
    """The table in the index: a row for each rule."""
    lines = ["| check | code | problem |", "|---|---|---|"]
    for check in checks:
        for number, rule in enumerate(check.rules):
            name = "" if number else f"[{check.name}]({check.name}.md){' (opt-in)' * check.opt_in}"
            note = "" if rule.status == "error" else f" ({rule.status})"
            lines.append(f"| {name} | {linked(check, rule.code)} | {rule.summary}{note} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
