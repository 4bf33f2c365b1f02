"""Where a corpus keeps demonstrations: a file for each recording, named by its digest, and rows that name the file and
have what came out of each episode. Caches of frames lie beside; nothing but the recording is needed to make one.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec

from envcraft.corpus.store import CorpusDamaged, Store, now
from envcraft.demonstrations.form import Episode, Recording, sha256

FOLDER, CACHE = "demonstrations", "frames"
_SUFFIX = ".demo"
_COLUMNS = "id, source, class, contract, player, seed, steps, file, contract_sha256, player_digest"


class Row(NamedTuple):
    """A recording as the table has it; `file` is its SHA-256 in hex."""

    number: int
    source: str
    env_class: str
    contract: str
    player: str
    seed: int
    steps: int
    file: str
    contract_sha256: str
    player_digest: str


class Outcome(NamedTuple):
    """What came out of a whole episode; `success` is None where nothing tells."""

    steps: int
    total: float
    success: int | None


def place(store: Store, file: str) -> Path:
    """Where a recording lies, or would."""
    return store.root / FOLDER / file[:2] / f"{file}{_SUFFIX}"


def cache_place(store: Store, file: str) -> Path:
    """Where the frames of a recording lie, or would."""
    return store.root / FOLDER / CACHE / file[:2] / f"{file}.frames"


def known(
    store: Store, source: str, env_class: str, contract_sha256: str, player: str, player_digest: str, seed: int
) -> Row | None:
    """The recording of these, if there is one."""
    row = store.db.execute(
        f"SELECT {_COLUMNS} FROM demonstrations WHERE source = ? AND class = ? AND contract_sha256 = ? "
        "AND player = ? AND player_digest = ? AND seed = ?",
        (source, env_class, contract_sha256, player, player_digest, seed),
    ).fetchone()
    return None if row is None else Row(*row)


def rows(store: Store, player: str | None = None) -> Iterator[tuple[str, Row]]:
    """The recordings of the corpus's environments, each with its first name, in the order of names and players."""
    columns = ", ".join(f"d.{column}" for column in _COLUMNS.split(", "))
    found = store.db.execute(
        f"SELECT min(name), {columns} FROM demonstrations AS d JOIN environments AS e "
        "ON e.source = d.source AND e.class = d.class WHERE ? IS NULL OR player = ? "
        "GROUP BY d.id ORDER BY 1, player, seed, d.id",
        (player, player),
    )
    for name, *row in found.fetchall():
        yield name, Row(*row)


def read(store: Store, row: Row) -> Recording:
    """A recording. Raises CorpusDamaged where its file is gone or has changed."""
    file = place(store, row.file)
    again = f"`envcraft corpus verify {store.root} --repair` takes it out, and `envcraft demos` records it again"
    try:
        data = file.read_bytes()
    except OSError as error:
        raise CorpusDamaged(f"the recording {file} cannot be read ({error.strerror})", again) from None
    if sha256(data) != row.file:
        raise CorpusDamaged(f"the recording {file} has changed", again)
    try:
        return Recording.from_bytes(data)
    except (msgspec.DecodeError, ValueError) as error:
        raise CorpusDamaged(f"the recording {file} is none that can be read: {error}", again) from None


def keep(store: Store, recording: Recording) -> None:
    """Write a recording down, in place of one that there was. Raises OSError."""
    data = recording.to_bytes()
    file = sha256(data)
    if not place(store, file).exists():
        store.keep(place(store, file), data)
    key = (
        recording.source,
        recording.env_class,
        recording.contract_sha256,
        recording.player,
        recording.player_digest,
        recording.seed,
    )
    before = known(store, *key)
    with store.transaction():
        if before is not None:
            store.db.execute("DELETE FROM demonstrations WHERE id = ?", (before.number,))
        cursor = store.db.execute(
            "INSERT INTO demonstrations (source, class, contract_sha256, player, player_digest, seed, contract, steps, "
            "file, recorded) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (*key, recording.contract, recording.steps, file, now()),
        )
        store.db.executemany(
            "INSERT INTO episodes VALUES (?, ?, ?, ?, ?, ?, ?)",
            [
                (cursor.lastrowid, number, one.seed, one.steps, one.total, one.success, _ended(one))
                for number, one in enumerate(recording.episodes)
            ],
        )
    if before is not None and before.file != file:
        _unlink(store, before.file)


def _ended(episode: Episode) -> str:
    return "terminated" if episode.terminated else "truncated" if episode.truncated else "cut"


def prune(store: Store) -> None:
    """Forget the recordings of what is no longer in the corpus."""
    gone = (
        "NOT EXISTS (SELECT 1 FROM environments AS e WHERE e.source = demonstrations.source "
        "AND e.class = demonstrations.class)"
    )
    left = [file for (file,) in store.db.execute(f"SELECT file FROM demonstrations WHERE {gone}")]
    store.db.execute(f"DELETE FROM demonstrations WHERE {gone}")
    for file in left:
        if not _named(store, file):
            _unlink(store, file)


def verify(store: Store, repair: bool) -> Iterator[str]:
    """What is wrong with the recordings, in words; with `repair` it is taken out, for the next run to make again."""
    for file in sorted(path for path in (store.root / FOLDER).rglob("*") if path.is_file()):
        name, digest = file.relative_to(store.root), file.stem
        cached = file.suffix != _SUFFIX
        if not _named(store, digest) or file != (cache_place if cached else place)(store, digest):
            words = f"{name} belongs to no recording"
        elif cached and (wrong := _cache_wrong(file)):
            words = f"{name} {wrong}"
        elif not cached and (found := sha256(file.read_bytes())) != digest:
            words = f"{name} has the digest {found}"
        else:
            continue
        if repair:
            file.unlink()
        yield words
    for number, player, digest in store.db.execute("SELECT id, player, file FROM demonstrations").fetchall():
        if place(store, digest).is_file():
            continue
        if repair:
            store.db.execute("DELETE FROM demonstrations WHERE id = ?", (number,))
            cache_place(store, digest).unlink(missing_ok=True)
        yield f"recording {number}, of the player {player}: its file is missing"


def _cache_wrong(file: Path) -> str:
    from envcraft.demonstrations.cache import CacheDamaged, check

    try:
        check(file)
    except CacheDamaged as error:
        return str(error)
    return ""


def _named(store: Store, file: str) -> bool:
    return store.db.execute("SELECT 1 FROM demonstrations WHERE file = ? LIMIT 1", (file,)).fetchone() is not None


def _unlink(store: Store, file: str) -> None:
    place(store, file).unlink(missing_ok=True)
    cache_place(store, file).unlink(missing_ok=True)


def outcomes(store: Store) -> dict[str, list[Outcome]]:
    """What came out of whole episodes, by player; of one that has changed since, in each environment the newest."""
    found: dict[str, list[Outcome]] = {}
    for player, *row in store.db.execute(
        "SELECT player, episodes.steps, total, success FROM episodes JOIN demonstrations AS d "
        "ON d.id = episodes.demonstration WHERE ending != 'cut' AND total IS NOT NULL "
        "AND EXISTS (SELECT 1 FROM environments AS e WHERE e.source = d.source AND e.class = d.class) "
        "AND NOT EXISTS (SELECT 1 FROM demonstrations AS later WHERE later.id > d.id AND later.source = d.source "
        "AND later.class = d.class AND later.contract_sha256 = d.contract_sha256 AND later.player = d.player "
        "AND later.seed = d.seed) ORDER BY player"
    ):
        found.setdefault(player, []).append(Outcome(*row))
    return found
