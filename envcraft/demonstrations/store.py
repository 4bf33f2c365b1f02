"""The recordings of a corpus: a file for each, named by its digest, and its rows in the database.

Caches of frames lie beside the files; a cache can always be made again from its recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec

from envcraft.corpus.store import CorpusDamaged, Store, demonstrations
from envcraft.corpus.store.demonstrations import EpisodeRow, Key, Row
from envcraft.demonstrations.format import Episode, Recording, sha256

FOLDER, CACHE = "demonstrations", "frames"
_SUFFIX = ".demo"


def recording_path(store: Store, file: str) -> Path:
    """The path of a recording, whether it exists or not."""
    return store.root / FOLDER / file[:2] / f"{file}{_SUFFIX}"


def cache_path(store: Store, file: str) -> Path:
    """The path of the frame cache of a recording, whether it exists or not."""
    return store.root / FOLDER / CACHE / file[:2] / f"{file}.frames"


def load(store: Store, row: Row) -> Recording:
    """Read a recording.

    Raises:
        CorpusDamaged: if its file is missing or has changed.
    """
    file = recording_path(store, row.file)
    again = f"`envcraft corpus verify {store.root} --repair` removes it, and `envcraft demos` records it again"
    try:
        data = file.read_bytes()
    except OSError as error:
        raise CorpusDamaged(f"cannot read the recording {file} ({error.strerror})", again) from None
    if sha256(data) != row.file:
        raise CorpusDamaged(f"the recording {file} has changed", again)
    try:
        return Recording.from_bytes(data)
    except (msgspec.DecodeError, ValueError) as error:
        raise CorpusDamaged(f"the recording {file} is invalid: {error}", again) from None


def save(store: Store, recording: Recording) -> None:
    """Store a recording in place of the one with the same key.

    Raises:
        OSError: if the file cannot be written.
    """
    data = recording.to_bytes()
    file = sha256(data)
    if not recording_path(store, file).exists():
        store.keep(recording_path(store, file), data)
    key = Key(
        recording.source,
        recording.env_class,
        recording.contract_sha256,
        recording.player,
        recording.player_digest,
        recording.seed,
    )
    episodes = [EpisodeRow(one.seed, one.steps, one.total, one.success, _ending(one)) for one in recording.episodes]
    before = demonstrations.replace(store, key, recording.contract, recording.steps, file, episodes)
    if before is not None and before.file != file:
        _unlink(store, before.file)


def _ending(episode: Episode) -> str:
    return "terminated" if episode.terminated else "truncated" if episode.truncated else "cut"


def prune(store: Store) -> None:
    """Delete the recordings of sources that the corpus no longer has."""
    for file in demonstrations.prune(store):
        if not demonstrations.is_referenced(store, file):
            _unlink(store, file)


def verify(store: Store, repair: bool) -> Iterator[str]:
    """Yield what is wrong with the recordings; with `repair`, remove it."""
    for file in sorted(path for path in (store.root / FOLDER).rglob("*") if path.is_file()):
        name, digest = file.relative_to(store.root), file.stem
        cached = file.suffix != _SUFFIX
        if not demonstrations.is_referenced(store, digest) or file != (cache_path if cached else recording_path)(
            store, digest
        ):
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
    for number, player, digest in demonstrations.files(store):
        if recording_path(store, digest).is_file():
            continue
        if repair:
            demonstrations.delete(store, number)
            cache_path(store, digest).unlink(missing_ok=True)
        yield f"the file of recording {number} of the player {player} is missing"


def _cache_wrong(file: Path) -> str:
    from envcraft.demonstrations.cache import CacheDamaged, check

    try:
        check(file)
    except CacheDamaged as error:
        return str(error)
    return ""


def _unlink(store: Store, file: str) -> None:
    recording_path(store, file).unlink(missing_ok=True)
    cache_path(store, file).unlink(missing_ok=True)
