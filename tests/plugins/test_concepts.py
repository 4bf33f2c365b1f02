"""Concepts: distinct, reproducible, in the given shares, with texts that name their ingredients."""

from __future__ import annotations

import itertools
import json
import re
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from envcraft_llm.concepts import generation
from envcraft_llm.concepts.generation import KINDS, SHARES, Coverage, capacity, concepts
from envcraft_llm.concepts.pools import Theme, buttons, pools
from envcraft_llm.concepts.strategies import STRATEGIES
from envcraft_llm.concepts.writing import LIMIT, Concept, text_sha256

from envcraft.cli.group import cli
from envcraft.errors import UsageError

NUMBER = 1_000
ALL = [strategy.name for strategy in STRATEGIES]


@cache
def made() -> list[Concept]:
    return list(concepts(NUMBER, seed=3))


def entries(concept: Concept) -> list[Any]:
    known = {kind: getattr(pools(), pool) for pool, kind in KINDS.items()}
    return [known[kind][name] for kind, _, name in (part.partition(":") for part in concept.ingredients)]


def test_no_two_have_one_text_or_the_same_ingredients() -> None:
    assert len({concept.text_sha256 for concept in made()}) == NUMBER
    assert len({concept.id for concept in made()}) == NUMBER
    assert len({tuple(concept.ingredients) for concept in made()}) == NUMBER
    assert all(concept.text_sha256 == text_sha256(concept.text) for concept in made())


def test_the_digest_is_of_words_and_numbers_alone() -> None:
    assert text_sha256("The Frog:  eats 3 flies.\n") == text_sha256("the frog eats 3 flies")
    assert text_sha256("the frog eats 3 flies") != text_sha256("the frog eats 4 flies")


def test_a_larger_run_begins_with_the_same_and_another_seed_does_not() -> None:
    assert list(concepts(40, seed=3)) == made()[:40]
    assert not {concept.id for concept in concepts(40, seed=4)} & {concept.id for concept in made()}


def test_no_process_makes_others() -> None:
    program = "from envcraft_llm.concepts.generation import concepts; print(*(c.id for c in concepts(12, 3)))"
    for hash_seed in ("1", "2"):
        environment = {"PYTHONHASHSEED": hash_seed}
        told = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True
        )
        assert told.stdout.split() == [concept.id for concept in made()[:12]]


def test_the_first_of_any_number_have_the_shares() -> None:
    counted: Counter[str] = Counter()
    for number, concept in enumerate(made(), 1):
        counted[concept.strategy] += 1
        assert all(abs(counted[name] - share * number) < 1.5 for name, share in SHARES.items())


def test_what_each_strategy_is_made_of() -> None:
    for concept in made():
        kinds = Counter(part.partition(":")[0] for part in concept.ingredients)
        assert kinds.pop("theme") == 1
        mashup = kinds.pop("mashup", 0)
        wanted = {
            "genre-blend": {"genre": 3},
            "mechanical": {"mechanic": 4},
            "thematic": {"mechanic": 1, "twist": 1},
            "experimental": {"experimental": 1, "twist": 1},
        }
        assert kinds == wanted[concept.strategy]
        assert len(set(concept.ingredients)) == len(concept.ingredients)
        assert mashup in ((0, 1) if concept.strategy == "genre-blend" else (0,))


def test_mechanics_of_a_game_can_be_played_at_once() -> None:
    for concept in made():
        if concept.strategy == "mechanical":
            _, pad, *others = entries(concept)
            assert [mechanic.control for mechanic in (pad, *others)].count("pad") == 1
            assert pad.control == "pad"
            assert all(pad.views[0] in other.views for other in others)
            groups = [mechanic.group for mechanic in (pad, *others) if mechanic.group]
            assert len(set(groups)) == len(groups)
            assert 1 <= sum(buttons(mechanic.rule) for mechanic in (pad, *others)) <= 2


def test_a_twist_goes_with_its_game() -> None:
    for concept in made():
        if concept.strategy in ("thematic", "experimental"):
            _, core, twist = entries(concept)
            assert set(core.views) & set(twist.views)
            text = f"{getattr(core, 'pad', '')} {core.rule}"
            assert twist.needs != "lives" or "a life" in text
            assert twist.needs != "buttons" or "{button" in text


def test_a_text_names_its_ingredients_and_all_of_its_numbers() -> None:
    for concept in made():
        for entry in entries(concept):
            if isinstance(entry, Theme):
                assert all(words in concept.text for words in (entry.name, entry.hero, entry.scene, *entry.palette))
            else:
                assert entry.name in concept.text
        numbers = set(re.findall(r"\d+(?:\.\d+)?", concept.text))
        assert len(concept.parameters) >= 3
        assert {str(value) for value in concept.parameters.values()} <= numbers


def test_numbers_are_within_the_ranges_of_their_entries() -> None:
    seen: dict[str, set[float]] = {}
    for concept in made():
        known = {entry.id: entry for entry in entries(concept)}
        for name, value in concept.parameters.items():
            part, _, parameter = name.partition(".")
            if part in known:
                lowest, highest, step = known[part].parameters[parameter]
                assert lowest <= value <= highest
                assert (value - lowest) / step == pytest.approx(round((value - lowest) / step))
                seen.setdefault(name, set()).add(value)
    assert sum(len(values) > 1 for values in seen.values()) > 0.9 * len(seen)


def test_a_text_is_whole_and_can_be_won_and_lost() -> None:
    for concept in made():
        text = concept.text
        heads = re.findall(r"^(Controls|Rules|Win|Loss|Picture): ", text, re.MULTILINE)
        assert heads == ["Controls", "Rules", "Win", "Loss", "Picture"]
        assert not re.search(r"[{}]|  |\.\.|\. [a-z]|(?<![.\d])1 (steps|pixels|cells)\b", text)
        assert ("lives is lost" in text) == bool(re.search(r"\ba life\b", text))
        lasting = "shepherd-night.last" in concept.parameters
        assert lasting or LIMIT[0] <= concept.parameters["game.limit"] <= LIMIT[1] <= 1000
        assert lasting != ("steps have passed without a win" in text)


def test_buttons_that_no_rule_needs_are_named() -> None:
    for concept in made():
        text = concept.text.lower()
        assert ("neither button is used" in text) == ("the first button" not in text)
        needed = "the second button" in text.replace("the second button is not used", "")
        assert ("the second button is not used" in text) == ("the first button" in text and not needed)


def test_every_entry_is_used_about_as_often_as_the_others() -> None:
    coverage = Coverage()
    for concept in made():
        coverage.add(concept)
    assert coverage.strategies == {"genre-blend": 400, "mechanical": 300, "thematic": 200, "experimental": 100}
    for pool, counted in coverage.entries.items():
        assert min(counted.values()) > 0, pool
        assert max(counted.values()) < 5 * min(counted.values()), pool


def test_capacities_are_what_can_be_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    known = pools()
    few = type(known)(
        dict(itertools.islice(known.genres.items(), 4)),
        {
            name: known.mechanics[name]
            for name in (
                *("push-blocks", "thruster-landing", "freezing-ray", "raised-shield", "magnet-pull"),
                *("breath-meter", "own-echo", "closing-border"),
            )
        },
        dict(itertools.islice(known.themes.items(), 2)),
        dict(itertools.islice(known.twists.items(), 3)),
        {},
        dict(itertools.islice(known.experimental.items(), 2)),
    )
    monkeypatch.setattr(generation, "pools", lambda: few)
    for name, most in capacity().items():
        if name == "genre-blend":
            # One in four is of a mashup, of which there are none here.
            continue
        found = list(concepts(most, 0, {name: 1}))
        assert len({tuple(concept.ingredients) for concept in found}) == most
        with pytest.raises(UsageError, match=f"has {most}: lower the count"):
            concepts(most + 1, 0, {name: 1})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--strategy-share", "genre-blend=0.4,mechanical=0.4"], "sum to 0.8"),
        (["--strategy-share", "genres=1"], "there is no strategy genres; choose from genre-blend, mechanical"),
        (["--strategy-share", "thematic=2,mechanical=-1"], "the share of thematic is 2"),
        (["--strategy-share", "thematic"], "is not a share"),
        (["--strategy-share", "thematic=0.5,thematic=0.5"], "each name once"),
        (["--strategy-share", "experimental=nan"], "a share is a number from 0 to 1"),
        (["--strategy-share", "experimental=1", "--count", "100000"], "experimental, which has"),
        (["--output", "/nowhere/at/all.jsonl"], "--output /nowhere/at/all.jsonl cannot be written"),
    ],
)
def test_usage_errors(arguments: list[str], words: str) -> None:
    result = CliRunner().invoke(cli, ["concepts", *arguments])
    assert result.exit_code == 2
    assert words in result.stderr
    assert not result.stdout


def test_the_command_writes_lines_and_tells_coverage(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["concepts", "--count", "10", "--seed", "3"])
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert [line["id"] for line in lines] == [concept.id for concept in made()[:10]]
    assert lines[0].keys() == {"id", "strategy", "title", "ingredients", "parameters", "text", "text_sha256"}
    assert "10 concepts: genre-blend 4, mechanical 3, thematic 2, experimental 1" in result.stderr
    assert re.search(r"^themes +\d+ of 51 used; most \d \(.+\), least 0", result.stderr, re.MULTILINE)

    output = tmp_path / "some.jsonl"
    again = CliRunner().invoke(cli, ["concepts", "--count", "10", "--seed", "3", "--output", str(output)])
    assert not again.stdout
    assert output.read_text("utf-8") == result.stdout


def test_texts_alone_and_one_strategy(tmp_path: Path) -> None:
    arguments = ["concepts", "--count", "3", "--format", "text", "--strategy-share", "experimental=1"]
    result = CliRunner().invoke(cli, arguments)
    assert result.stdout.count("This game is an experiment:") == 3
    assert "3 concepts: experimental 3" in result.stderr


def test_help_reads_no_pool() -> None:
    program = (
        "import sys; from envcraft.cli.group import cli; cli(['--help'], standalone_mode=False); "
        "sys.exit(any(name.startswith('envcraft_llm.concepts.') and not name.endswith('.command') "
        "for name in sys.modules) or 'tomllib' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "concepts" in result.stdout
