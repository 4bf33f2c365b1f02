"""The planted copies have the properties that the layers rely on, and precision and recall are correct."""

from __future__ import annotations

import random

import pytest

from benchmarks import duplicates
from benchmarks.duplicates import File, edited, equal, reformatted, renamed, score
from envcraft.similarity import exact, near, structural
from evaluation.fixtures import ROOT


@pytest.mark.parametrize("name", ["snake", "invaders"])
def test_planted_copies(name: str) -> None:
    text = (ROOT / "examples" / f"{name}.py").read_text("utf-8")
    source, rng = text.encode(), random.Random(0)
    same = reformatted(text, rng).encode()
    assert same != source
    assert exact.key(same) == exact.key(source)
    other_names = renamed(text, rng).encode()
    assert exact.key(other_names) != exact.key(source)
    assert structural.key(other_names) == structural.key(source)
    other_numbers = edited(text, rng).encode()
    assert structural.key(other_numbers) != structural.key(source)
    sets = [near.shingles(near.key(one) or b"") for one in (source, other_numbers)]
    assert near.jaccard(*sets) > near.THRESHOLD


def test_precision_and_recall() -> None:
    files = [File(b"", 0, ""), File(b"", 0, "exact"), File(b"", 0, "renamed"), File(b"", 1, ""), File(b"", 1, "exact")]
    right = equal([b"a", b"a", None, b"b", b"b"])
    assert score(files, right, ("exact",)) == (1, 1)
    assert score(files, right, ("exact", "renamed")) == (1, 0.5)
    assert score(files, equal([b"a", b"a", None, b"a", None]), ("exact",)) == (1 / 3, 0.5)


def test_a_layer_that_finds_too_little_breaks_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rensa")
    few = [(ROOT / "examples" / f"{name}.py").read_bytes() for name in ("snake", "lander", "crossing")]
    monkeypatch.setattr(duplicates, "originals", lambda: few)
    small = ["--number", "12", "--played", "0"]
    assert duplicates.main(small) == 0
    monkeypatch.setattr(structural, "key", exact.key)
    assert duplicates.main(small) == 1
