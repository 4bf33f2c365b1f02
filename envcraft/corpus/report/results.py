"""The results of training on the first page: files that ``envcraft evaluate --output`` wrote."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from envcraft.errors import UsageError
from envcraft.text import one_line

_FORMAT = 1


class _Mean(msgspec.Struct):
    mean: float


class _Played(msgspec.Struct):
    name: str
    episodes: int
    length: _Mean
    total: _Mean = msgspec.field(name="return")


class _File(msgspec.Struct):
    format: int
    player: str
    environments: list[_Played]


class ResultRow(NamedTuple):
    """One evaluation of a player.

    Attributes:
        player: its name.
        environments: how many it played.
        episodes: in all of them.
        total: the mean over the environments of the mean return.
        steps: the mean over the environments of the mean length.
        better: in how many of the environments of the first row its mean return is higher than that row's.
        shared: how many environments it has in common with the first row.
    """

    player: str
    environments: int
    episodes: int
    total: float
    steps: float
    better: int
    shared: int


def result_rows(files: Sequence[Path]) -> list[ResultRow]:
    """Read the results of several players; the first one is what the others are compared with.

    Args:
        files: the files.

    Raises:
        UsageError: a file is not of this kind.
    """
    read = [_read(path) for path in files]
    first = {played.name: played.total.mean for played in read[0].environments} if read else {}
    rows = []
    for one in read:
        shared = [played for played in one.environments if played.name in first]
        rows.append(
            ResultRow(
                one_line(one.player),
                len(one.environments),
                sum(played.episodes for played in one.environments),
                float(np.mean([played.total.mean for played in one.environments])),
                float(np.mean([played.length.mean for played in one.environments])),
                sum(played.total.mean > first[played.name] for played in shared),
                len(shared),
            )
        )
    return rows


def _read(path: Path) -> _File:
    hint = "give a file that `envcraft evaluate --output` wrote"
    try:
        read = msgspec.json.decode(path.read_bytes(), type=_File)
    except OSError as error:
        raise UsageError(f"the results {path} cannot be read ({error.strerror}); {hint}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} has no results ({one_line(error)}); {hint}") from None
    if read.format != _FORMAT or not read.environments:
        raise UsageError(f"{path} has results of format {read.format} on {len(read.environments)} environments; {hint}")
    return read
