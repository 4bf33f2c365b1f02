"""Frames of a finding: the reproduction run again in the sandbox, and PNG files that other programs read."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envcraft.contracts.lookup import contract_named
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import driver_for
from envcraft.judging.engine import Plan
from envcraft.judging.frame_renderer import MOST, FrameRenderer, pixels, png
from envcraft.judging.selection import default_checks, driver_named
from envcraft.model.target import Kind, Target, read_target
from envcraft.model.verdict import Finding, Repro, Severity, SubjectReport, Verdict

RIGHT, STAY = [4, 0, 0], [0, 0, 0]


def read(data: bytes) -> np.ndarray[Any, Any]:
    from PIL import Image

    with Image.open(io.BytesIO(data)) as image:
        image.load()
        assert image.format == "PNG"
        return np.array(image.convert("RGB"))


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 600), st.randoms(use_true_random=False))
def test_pictures_come_back_from_png(height: int, width: int, colours: int, random: Any) -> None:
    palette = np.array([[random.randrange(256) for _ in range(3)] for _ in range(colours)], np.uint8)
    picture = palette[np.array([random.randrange(colours) for _ in range(height * width)])].reshape(height, width, 3)
    assert np.array_equal(read(png(picture)), picture)


def test_few_colours_take_few_bytes() -> None:
    picture = np.zeros((84, 84, 3), np.uint8)
    picture[20:40, 30:60] = (200, 30, 40)
    assert len(png(picture)) < 300


def test_what_is_no_picture_has_no_pixels() -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    for frame in (grey, grey[..., None]):
        shown = pixels(frame)
        assert shown is not None
        assert np.array_equal(shown, np.dstack([grey] * 3))
    large = pixels(np.zeros((2000, 10, 3), np.uint8))
    assert large is not None
    assert large.shape[0] <= 256
    for shape, dtype in (((4,), np.uint8), ((4, 4, 4), np.uint8), ((0, 4, 3), np.uint8), ((4, 4, 3), np.float32)):
        assert pixels(np.zeros(shape, dtype)) is None


@pytest.fixture
def film(good: Path) -> Any:
    """Frames of the walk's reproductions, by action list and conditions."""
    target = read_target(str(good))
    plan = Plan([target], contract_named("arcade"), driver_named("process"), default_checks(), BUDGETS["quick"])
    report = SubjectReport(target.path, "Walk", target.sha256, Verdict.FAIL, "process", 0.0, 0, [])
    with FrameRenderer(plan, findings=5) as frames:

        def ask(actions: list[Any], conditions: dict[str, Any] | None = None, path: str | None = None) -> Any:
            report.path = path or target.path
            repro = Repro(0, actions, conditions or {})
            return frames(report, Finding("EC301", Severity.ERROR, "", repro=repro))

        yield ask


def test_each_frame_is_what_the_episode_showed(film: Any) -> None:
    frames = film([RIGHT, RIGHT])
    assert [frame.step for frame in frames] == [0, 1, 2]
    places = [np.flatnonzero(read(frame.png)[41, :, 0] == 255).min() // 6 for frame in frames]
    assert places == [5, 6, 7]
    assert [frame.step for frame in film([STAY], {"hash_seed": 1, "fresh": True})] == [0, 1]


def test_the_last_frames_of_a_long_episode_are_shown(film: Any) -> None:
    frames = film([STAY] * 95)
    assert len(frames) == MOST
    assert frames[-1].step == 95


def test_what_cannot_be_shown_has_no_frames(film: Any, good: Path) -> None:
    assert film([STAY], path="another.py") == []
    assert film([STAY], {"clock": "noon"}) == []
    assert film([STAY] * 5000) == []


def test_so_many_findings_and_no_more(film: Any) -> None:
    assert [bool(film([RIGHT] * steps)) for steps in range(1, 8)] == [True] * 5 + [False] * 2


def test_an_environment_that_raises_shows_what_came_before(film: Any, good: Path) -> None:
    good.write_text(good.read_text().replace("self.steps += 1", "self.steps += 1\n        assert self.steps < 3"))
    target = read_target(str(good))
    plan = Plan([target], contract_named("arcade"), driver_named("process"), default_checks(), BUDGETS["quick"])
    report = SubjectReport(target.path, "Walk", target.sha256, Verdict.FAIL, "process", 0.0, 0, [])
    finding = Finding("EC107", Severity.ERROR, "", repro=Repro(0, [STAY] * 3))
    with FrameRenderer(plan) as frames:
        assert [frame.step for frame in frames(report, finding)] == [0, 1, 2]
    target = read_target(__file__)
    with FrameRenderer(Plan([target], plan.contract, plan.driver, [], plan.budget)) as frames:
        report.path = target.path
        assert frames(report, finding) == []


def test_where_observations_are_no_pictures_render_is_shown() -> None:
    target = Target("CartPole-v1", kind=Kind.ID)
    driver = driver_named("process")
    plan = Plan([target], contract_named("gymnasium"), driver_for(driver, [target]), default_checks(), BUDGETS["quick"])
    report = SubjectReport(target.path, "", target.sha256, Verdict.FAIL, "process", 0.0, 0, [])
    with FrameRenderer(plan) as frames:
        shown = frames(report, Finding("EC301", Severity.ERROR, "", repro=Repro(0, [1, 1, 0])))
    assert [frame.step for frame in shown] == [0, 1, 2, 3]
    first, *_, last = (read(frame.png) for frame in shown)
    # 600 pixels wide as rendered, every third of them kept.
    assert first.shape == (134, 200, 3)
    assert not np.array_equal(first, last)
