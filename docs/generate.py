"""``make docs``: write the rule pages and the README's rule table from the checks, and the page on pytest from the
plugin's docstring; with ``--check`` only compare.
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path

from envcraft import pytest_plugin
from envcraft.check import Check
from envcraft.plugins import plugins

ROOT = Path(__file__).resolve().parent.parent
_TABLE = re.compile(r"(?<=<!-- rules -->\n).*?(?=<!-- /rules -->)", re.DOTALL)


def main() -> int:
    checks: list[Check] = plugins().collect("envcraft_checks")
    pages = {ROOT / "docs" / "rules" / f"{check.name}.md": page(check) for check in checks}
    pages[ROOT / "docs" / "pytest.md"] = inspect.cleandoc(pytest_plugin.__doc__ or "") + "\n"
    readme = ROOT / "README.md"
    text = readme.read_text("utf-8")
    if not _TABLE.search(text):
        print("README.md has no place for the rule table", file=sys.stderr)
        return 1
    pages[readme] = _TABLE.sub(lambda _: table(checks), text)
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


def page(check: Check) -> str:
    """A check's page: its module's docstring, and its rules."""
    rows = [f"| {rule.code} | `{rule.name}` | {rule.severity} | {rule.summary} | {rule.fix} |" for rule in check.rules]
    head = "| code | name | severity | what is wrong | what usually mends it |\n|---|---|---|---|---|\n"
    return check.page.rstrip() + "\n\n## Rules\n" + head + "\n".join(rows) + "\n"


def table(checks: list[Check]) -> str:
    """The README's table: a row for each rule."""
    lines = ["| check | code | what is wrong |", "|---|---|---|"]
    for check in checks:
        for number, rule in enumerate(check.rules):
            name = "" if number else f"[{check.name}](docs/rules/{check.name}.md){' (opt-in)' * check.opt_in}"
            note = " (warning)" if rule.severity == "warning" else ""
            lines.append(f"| {name} | {rule.code} | {rule.summary}{note} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
