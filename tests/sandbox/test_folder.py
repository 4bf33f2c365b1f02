"""The job's folder is measured and emptied, links and deep folders included."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from envcraft_sandbox.worker.folder import JobFolder

_MOST = 1024**2


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[JobFolder]:
    folder = JobFolder(str(tmp_path / "job"))
    yield folder
    folder.empty()


def nest(folder: JobFolder, depth: int) -> None:
    here = os.open(folder.path, os.O_RDONLY)
    for _ in range(depth):
        os.mkdir("d", dir_fd=here)
        inner = os.open("d", os.O_RDONLY, dir_fd=here)
        os.close(here)
        here = inner
    os.close(here)


def test_a_file_counts_with_its_blocks(folder: JobFolder) -> None:
    (Path(folder.path) / "saved").write_bytes(b"x" * 100_000)
    assert 100_000 <= folder.bytes(_MOST) <= 120_000


def test_a_link_counts_without_what_it_names(folder: JobFolder, tmp_path: Path) -> None:
    (tmp_path / "large").write_bytes(b"x" * 100_000)
    (Path(folder.path) / "link").symlink_to(tmp_path / "large")
    assert folder.bytes(_MOST) < 10_000


def test_nested_folders_count(folder: JobFolder) -> None:
    nest(folder, 50)
    assert 50 * 1024 <= folder.bytes(_MOST) <= _MOST


@pytest.mark.parametrize("depth", [600, 2_500])
def test_folders_too_deep_exceed_every_limit(folder: JobFolder, depth: int) -> None:
    nest(folder, depth)
    assert folder.bytes(_MOST) > _MOST


def test_deep_folders_are_removed(folder: JobFolder) -> None:
    nest(folder, 2_500)
    folder.empty()
    assert os.listdir(folder.path) == []
