"""What nearly all environments of a corpus have is said once."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from envcraft.corpus.shared import shared_codes
from envcraft.judging.selection import all_checks

from .conftest import ENVIRONMENT, QUICK, Invoke

_MEANT = "if this is intended, waive it in a contract with"


@pytest.mark.parametrize(
    ("counts", "judged", "words"),
    [
        ({"EC112": 97, "EC201": 12}, 100, [f'EC112 in 97% of 100 environments: {_MEANT} render = "optional"']),
        ({"EC201": 10}, 10, [f'EC201 in 100% of 10 environments: {_MEANT} without = ["EC201"]']),
        ({"EC901": 10}, 10, ["EC901 in 100% of 10 environments: they probably have one cause"]),
        ({"ZZ001": 10}, 10, ["ZZ001 in 100% of 10 environments: they probably have one cause"]),
        ({"EC112": 79}, 100, []),
        ({"EC112": 9}, 9, []),
        ({}, 0, []),
    ],
)
def test_shared_codes(counts: dict[str, int], judged: int, words: list[str]) -> None:
    assert [each.words for each in shared_codes(counts, judged, all_checks())] == words


def test_an_audit_names_them_first_and_once(tmp_path: Path, invoke: Invoke) -> None:
    games = tmp_path / "games"
    games.mkdir()
    broken = f"{ENVIRONMENT}\n    def close(self):\n        del self.x\n"
    for number in range(10):
        # Equal sources would be one environment.
        text = broken.replace("CRASH", "7" if number == 3 else f"-{number + 1}")
        (games / f"{number}.py").write_text(text + "\n\nprint('ready')\n" * (number == 4))
    result = invoke("audit", "games", *QUICK, "--format", "json")
    (shared,) = json.loads(result.stdout)["audit"]["shared"]
    assert shared == {"code": "EC113", "environments": 10, "judged": 10, "waiver": 'without = ["EC113"]'}
    lines = [line.strip() for line in invoke("audit", "games", *QUICK).stdout.splitlines()]
    assert sum("EC113" in line for line in lines) == 1
    assert "EC107  in 1 environment" in lines
    assert "EC009 (warning)  in 1 environment" in lines
