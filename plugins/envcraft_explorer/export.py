"""The recorded episodes of a static export: of players, and of the first findings."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from envcraft.corpus.report.data import Entry
from envcraft.errors import EnvCraftError
from envcraft.judging.engine import cores
from envcraft.text import one_line
from envcraft_explorer.recording import Recorded, of_finding, of_player
from envcraft_explorer.stage import Stage

#: A player that plays any environment but takes too long for all of them, and how many findings of one are recorded.
_LEFT_OUT, _FINDINGS = "search", 5
#: Environments in one folder, as for previews.
_FOLDER = 500
_MESSAGE_EVERY = 100


def record_all(stage: Stage, folder: Path, message: Callable[[str], None]) -> Callable[[Entry, Path], list[Any]]:
    """Record episodes of all environments, several at a time.

    The page says which episodes are missing and why.

    Args:
        stage: the environments.
        folder: an existing folder for what is recorded.
        message: called with each line about the progress.

    Returns:
        A function that puts the pictures of an environment into a site, and returns what its page needs.
    """
    names = stage.names()

    def record(number: int) -> None:
        found: list[dict[str, Any]] = []
        for place, recorded in enumerate(_episodes(stage, names[number])):
            found.append(recorded.data)
            if recorded.picture is not None:
                found[-1]["picture"] = f"{number}-{place}.webp"
                (folder / found[-1]["picture"]).write_bytes(recorded.picture)
        (folder / f"{number}.json").write_bytes(msgspec.json.encode(found))

    with ThreadPoolExecutor(cores(), "envcraft-export") as threads:
        for done, _ in enumerate(threads.map(record, range(len(names))), 1):
            if done % _MESSAGE_EVERY == 0:
                message(f"{done:,} of {len(names):,} environments played")

    def put(entry: Entry, site: Path) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = msgspec.json.decode((folder / f"{entry.number}.json").read_bytes())
        target = Path("episodes") / str(entry.number // _FOLDER)
        for episode in found:
            if "picture" not in episode:
                continue
            (site / target).mkdir(parents=True, exist_ok=True)
            os.replace(folder / episode["picture"], site / target / episode["picture"])
            episode["picture"] = str(target / episode["picture"])
        return found

    return put


def _episodes(stage: Stage, name: str) -> Iterator[Recorded]:
    players, findings = list(stage.players(name).values()), stage.findings(name)
    with contextlib.suppress(EnvCraftError), stage.subject(name) as subject:
        for player in players:
            if player.name == _LEFT_OUT:
                yield _omitted("it takes too long for all environments", label=player.name)
            elif player.policy is None:
                yield _tried(partial(of_player, subject, player, 0), label=player.name)
        for number, (check, finding) in enumerate(findings[:_FINDINGS], 1):
            yield _tried(partial(of_finding, subject, check, finding, number), label=finding.code, finding=number)
    for number, (_, finding) in enumerate(findings[_FINDINGS:], _FINDINGS + 1):
        yield _omitted(f"only those of the first {_FINDINGS} findings are", label=finding.code, finding=number)
    for player in players:
        if player.policy is not None:
            with contextlib.suppress(EnvCraftError), stage.subject(name, player.policy) as subject:
                yield _tried(partial(of_player, subject, player, 0), label=player.name)


def _tried(play: Callable[[], Recorded], **about: Any) -> Recorded:
    try:
        recorded = play()
    except EnvCraftError as error:
        return _omitted(str(error), **about)
    return recorded if recorded.picture is not None else _omitted(recorded.data["words"], **about)


def _omitted(reason: str, **about: Any) -> Recorded:
    return Recorded({**about, "label": one_line(about["label"]), "omitted": one_line(reason)}, None)
