"""What is generated is up to date, and what the documentation names exists."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from envcraft.plugins import plugins


def test_rule_pages_and_table_are_up_to_date(root: Path) -> None:
    command = [sys.executable, "-m", "docs.generate", "--check"]
    result = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr


def test_links_in_the_readme_lead_somewhere(root: Path) -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)", (root / "README.md").read_text("utf-8"))
    assert len(links) > 10
    assert not [link for link in links if not (root / link).exists()]


def test_codes_are_unique_and_every_rule_says_how_to_mend_it() -> None:
    rules = [rule for check in plugins().collect("envcraft_checks") for rule in check.rules]
    assert len({rule.code for rule in rules}) == len({rule.name for rule in rules}) == len(rules)
    assert all(re.fullmatch(r"EC\d{3}", rule.code) for rule in rules)
    assert all(rule.summary.endswith(".") and rule.fix.endswith(".") for rule in rules)
