"""The comparison with the peers covers every check that has fixtures."""

from __future__ import annotations

from benchmarks.detection import TOPICS
from evaluation.fixtures import fixtures


def test_each_check_has_a_topic() -> None:
    assert set(TOPICS) == {fixture.check for fixture in fixtures()}
