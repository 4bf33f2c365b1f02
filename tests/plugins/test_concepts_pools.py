"""The pools: number of entries, and requirements on each entry."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator

import pytest
from envcraft_llm.concepts.pools import BUTTONS, THEMED, Entry, Theme, buttons, fields, pools

SIZES = {"genres": 42, "mechanics": 56, "themes": 51, "twists": 36, "mashups": 19, "experimental": 30}
POOLS = {name: getattr(pools(), name) for name in SIZES}
RULED = [name for name in SIZES if name != "themes"]
#: Texts of an entry, and those of them that go on where a sentence has begun.
TEXTS, CLAUSES = ("pad", "loop", "rule", "lend", "win", "loss"), ("win", "loss")
BRANDS = {"tetris", "pong", "breakout", "mario", "sokoban", "qix", "frogger", "asteroids", "bejeweled", "arkanoid"}


def templates(entry: Entry) -> dict[str, str]:
    return {name: text for name in TEXTS if (text := getattr(entry, name, None)) is not None}


def words(entry: Entry) -> set[str]:
    texts = templates(entry).values() if not isinstance(entry, Theme) else [entry.scene, entry.hero, *entry.palette]
    return {word for word in re.findall(r"[a-z]+", " ".join([entry.name, *texts]).lower()) if len(word) > 3}


@pytest.mark.parametrize(("pool", "size"), SIZES.items())
def test_a_pool_has_exactly_so_many_entries(pool: str, size: int) -> None:
    assert len(POOLS[pool]) == size


@pytest.mark.parametrize("pool", SIZES)
def test_entries_are_named_differently_and_are_no_near_duplicates(pool: str) -> None:
    entries = list(POOLS[pool].values())
    assert len({entry.name.lower() for entry in entries}) == len(entries)
    assert all(re.fullmatch(r"[a-z]+(-[a-z]+)*", entry.id) for entry in entries)
    known = [(entry.id, words(entry)) for entry in entries]
    alike = [(a, b) for (a, one), (b, two) in itertools.combinations(known, 2) if len(one & two) > 0.4 * len(one | two)]
    assert not alike


@pytest.mark.parametrize("pool", RULED)
def test_parameters_are_those_in_the_texts_and_have_ranges(pool: str) -> None:
    for part in POOLS[pool].values():
        used = {name for text in templates(part).values() for name in fields(text)} - THEMED - {*BUTTONS}
        assert used == part.parameters.keys(), part.id
        assert len(used) >= 2 or not hasattr(part, "win"), part.id
        for name, (lowest, highest, step) in part.parameters.items():
            steps = (highest - lowest) / step
            assert round(steps) >= 1, (part.id, name)
            assert steps == pytest.approx(round(steps)), (part.id, name)


@pytest.mark.parametrize("pool", RULED)
def test_texts_are_sentences_or_clauses_without_brands(pool: str) -> None:
    for part in POOLS[pool].values():
        for name, text in templates(part).items():
            assert text.isascii(), part.id
            assert not {*re.findall(r"[a-z]+", text.lower())} & BRANDS, part.id
            assert text.endswith(".") != (name in CLAUSES), (part.id, name)
            starts = re.findall(r"(?:^|\. )(\S)", text)
            if name in CLAUSES:
                assert len(starts) == 1, (part.id, name)
                assert not starts[0].isupper(), (part.id, name)
            else:
                assert all(start.isupper() or not start.isalpha() for start in starts), (part.id, name)
                assert len(text.split()) >= 12, (part.id, name)


@pytest.mark.parametrize("pool", RULED)
def test_no_entry_needs_more_than_two_buttons_or_the_second_without_the_first(pool: str) -> None:
    for part in POOLS[pool].values():
        texts = list(templates(part).values())
        first, second = (any(name in fields(text) for text in texts) for name in BUTTONS)
        assert first or not second, part.id


def test_mechanics_need_what_their_control_says() -> None:
    for mechanic in pools().mechanics.values():
        needed = buttons(mechanic.rule)
        assert needed in {"pad": (0, 1), "button": (1,), "world": (0,)}[mechanic.control], mechanic.id
        assert mechanic.control != "pad" or len(mechanic.views) == 1
    assert {mechanic.control for mechanic in pools().mechanics.values()} == {"pad", "button", "world"}


def test_genres_say_what_is_typical_and_lend_without_taking_over() -> None:
    for genre in pools().genres.values():
        assert len(genre.objects) >= 2
        assert buttons(genre.lend) <= 1
        assert THEMED & {*fields(" ".join([genre.pad, genre.loop]))}, genre.id


def test_mashups_mix_two_or_three_genres_that_exist() -> None:
    sizes = set()
    for mashup in pools().mashups.values():
        assert len(set(mashup.genres)) == len(mashup.genres)
        assert pools().genres.keys() >= set(mashup.genres)
        assert buttons(mashup.rule) == 0
        sizes.add(len(mashup.genres))
    assert sizes == {2, 3}


def test_nouns_of_a_theme_differ() -> None:
    for theme in pools().themes.values():
        nouns = list(_nouns(theme))
        assert len(set(nouns)) == len(nouns), theme.id
        assert len(set(theme.palette)) == 4


def _nouns(theme: Theme) -> Iterator[str]:
    yield from (theme.hero, theme.home, theme.foe[0], theme.prize[0], theme.block[0])
