"""The layer of near-duplicates: edits are found, the scaffold is not taken for likeness, a crowd not for scaffold."""

from __future__ import annotations

import builtins
from typing import Any

import numpy as np
import pytest

from envcraft.errors import UsageError
from envcraft.similarity import near
from envcraft.similarity.groups import Groups
from tests.similarity.games import RULES, game

pytest.importorskip("rensa")


def sets(*sources: bytes) -> list[near.Shingles]:
    return [near.shingles(near.key(source) or b"") for source in sources]


def groups(found: list[near.Shingles], threshold: float = near.THRESHOLD) -> list[list[int]]:
    """The clusters of more than one, of what is left without the scaffold."""
    left = [(number, rest) for number, rest in enumerate(near.own(found)) if rest is not None]
    joined = Groups(len(left))
    for one, two in near.pairs([rest for _, rest in left], threshold, joined):
        joined.join(one, two)
    return [[left[place][0] for place in group] for group in joined.all() if len(group) > 1]


def test_jaccard_index() -> None:
    one, two = np.arange(0, 10, dtype=np.uint32), np.arange(5, 20, dtype=np.uint32)
    assert near.jaccard(one, two) == 5 / 20
    assert near.jaccard(one, one) == 1
    assert near.jaccard(one[:0], two[:0]) == 0


def test_five_tokens_together_and_no_comments() -> None:
    assert len(near.shingles(near.key(b"a = b + c  # d e f\n\n'docstring'\n") or b"")) == 1
    assert len(near.shingles(near.key(b"a = b + c + d\n") or b"")) == 3
    assert near.key(b"a = b\n") == b""


def test_games_on_one_scaffold_are_not_one_game() -> None:
    found = sets(*(game(number) for number in range(len(RULES))))
    # All of them would be, if the scaffold counted.
    assert near.jaccard(found[0], found[4]) > near.THRESHOLD
    assert groups(found) == []


def test_a_changed_constant_is_found_among_them() -> None:
    changed = game(4).replace(b"% 24", b"% 30")
    assert changed != game(4)
    found = sets(*(game(number) for number in range(len(RULES))), changed)
    assert groups(found) == [[4, len(RULES)]]


def test_a_crowd_of_copies_is_no_scaffold() -> None:
    crowd = [game(0).replace(b">= 500", b">= %d" % number) for number in range(300, 330)]
    found = sets(*crowd, *(game(number) for number in range(1, len(RULES))))
    assert groups(found) == [list(range(30))]


def test_nothing_is_scaffold_of_few() -> None:
    left = near.own(sets(game(0), game(1), game(2)))
    assert all(rest is not None and len(rest) > 200 for rest in left)


def test_source_with_few_shingles_has_no_key() -> None:
    bare = game(0)[: game(0).index(b"    def rule")]
    found = near.own(sets(*(game(number) for number in range(len(RULES))), bare))
    assert found[-1] is None
    assert sum(rest is None for rest in found) == 1


@pytest.mark.parametrize("threshold", [0.5, 0.7, 0.9])
def test_all_pairs_above_the_threshold_and_none_below(threshold: float) -> None:
    rng = np.random.default_rng(0)
    base = rng.integers(0, 2**32, 400, dtype=np.uint32)
    # Of each, some others in place of its own: indices from 0.3 to 1.
    found = []
    for number in range(60):
        kept = int(400 * (0.5 + number / 120))
        found.append(np.unique(np.concatenate([base[:kept], rng.integers(0, 2**32, 400 - kept, dtype=np.uint32)])))
    wanted = {
        (one, two) for two in range(60) for one in range(two) if near.jaccard(found[one], found[two]) >= threshold
    }
    assert len(wanted) >= 15
    got = set(near.pairs(found, threshold, Groups(60)))
    assert got <= wanted
    assert len(got) >= 0.97 * len(wanted)


def test_the_kernel_is_one() -> None:
    found = sets(*(game(number) for number in range(4)), game(0))
    measured = near.kernel(found)
    assert np.allclose(np.diag(measured), 1)
    assert measured[0, 4] == 1
    assert np.linalg.eigvalsh(measured).min() > -1e-9
    for one in range(5):
        for two in range(5):
            assert abs(measured[one, two] - near.jaccard(found[one], found[two])) < 0.2


def test_without_rensa_what_to_install_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == "rensa":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UsageError, match=r"envcraft-rl\[corpus\]"):
        near.own(sets(game(0)))
