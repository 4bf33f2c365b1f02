"""Pictures of environments: a few frames of one random episode each, below one another in one small file.

They are played in the sandbox, once for each source, and kept in the corpus by the digest of their contents. A row of
``previews`` names the file of a source and class, or none where an environment shows no picture.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.budget import BUDGETS
from envcraft.check import Check
from envcraft.contract import Contract
from envcraft.corpus.audit import stored
from envcraft.corpus.settings import contract_digest
from envcraft.corpus.store import Environment, Store
from envcraft.engine import Plan, stream
from envcraft.events import SubjectFinished
from envcraft.frames import rgb, seen, sighted
from envcraft.pool import Pool
from envcraft.rollout import Conditions
from envcraft.sandbox import Driver, Limits
from envcraft.subject import Subject
from envcraft.verdict import Finding, Verdict

MEDIA = "media"
#: Pixels of either side of a frame, frames of a preview, and steps of the episode that they are taken from.
SIDE, FRAMES, STEPS = 84, 12, 60
#: Bytes of one preview, at the most.
MOST = 10 * 1024
#: What is tried in turn until a preview is small enough: frames, and quality; None loses nothing.
_CODINGS: tuple[tuple[int, int | None], ...] = ((FRAMES, None), (FRAMES, 60), (FRAMES, 25), (6, 25), (3, 10), (1, 0))
#: Part of the recipe: another number, and every preview is made anew.
_VERSION = 1
_LIMITS = Limits(job=20.0, total=40.0)
_TELL_EVERY = 15.0


class _Preview(Check):
    """Judges nothing: plays a little with held actions, and gives the pictures to `take`."""

    name = "preview"
    rules = ()

    def __init__(self, take: Callable[[str, bytes], object]) -> None:
        self._take = take

    def judge(self, subject: Subject) -> Iterator[Finding]:
        conditions = sighted(subject, Conditions())
        rollout = subject.players.sticky(0).cut(STEPS).under(conditions)
        # Not remembered: nobody asks for it a second time.
        trace = subject.rerun(msgspec.structs.replace(rollout, keep=STEPS + 1))
        frames = [picture for frame in seen(trace) if (picture := rgb(frame)) is not None]
        if frames:
            self._take(subject.target.path, encode(frames))
        return iter(())


def pillow() -> Any:
    """The module ``PIL.Image`` where pictures can be written, else None."""
    try:
        from PIL import Image, features
    except ImportError:
        return None
    return Image if features.check("webp") else None


def encode(frames: Sequence[NDArray[np.uint8]]) -> bytes:
    """Frames (height, width, 3), not all of which are taken, as one WebP file of at most `MOST` bytes: `SIDE` wide, one
    square below the other. Needs Pillow.
    """
    image = pillow()
    data = b""
    for count, quality in _CODINGS:
        picked = np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int)
        strip = np.vstack([_square(image, frames[place]) for place in picked])
        written = io.BytesIO()
        image.fromarray(strip).save(written, "WEBP", lossless=quality is None, quality=quality or 0, method=4)
        data = written.getvalue()
        if len(data) <= MOST:
            break
    return data


def _square(image: Any, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A frame in the middle of a square, as large as fits."""
    if frame.shape[:2] == (SIDE, SIDE):
        return frame
    height, width = frame.shape[:2]
    scale = SIDE / max(height, width)
    size = (max(round(width * scale), 1), max(round(height * scale), 1))
    small = image.fromarray(frame).resize(size, image.Resampling.BOX if scale < 1 else image.Resampling.NEAREST)
    made: NDArray[np.uint8] = np.zeros((SIDE, SIDE, 3), np.uint8)
    top, left = (SIDE - size[1]) // 2, (SIDE - size[0]) // 2
    made[top : top + size[1], left : left + size[0]] = np.asarray(small)
    return made


def place(store: Store, sha256: str) -> Path:
    """Where a preview lies, or would."""
    return store.root / MEDIA / sha256[:2] / f"{sha256}.webp"


def preview(store: Store, environment: Environment) -> Path | None:
    """The file with an environment's preview, if there is one."""
    row = store.db.execute(
        "SELECT media FROM previews WHERE source = ? AND class = ? AND media IS NOT NULL",
        (environment.source, environment.env_class),
    ).fetchone()
    file = None if row is None else place(store, row[0])
    return file if file is not None and file.is_file() else None


def make(store: Store, contract: Contract, otherwise: str, driver: Driver, workers: int | None = None) -> int:
    """Play what was last judged under this contract and has no preview yet, but for what `source` refused; give how
    many were played. What was never judged counts as judged under the contract called `otherwise`.

    Each is written down as it comes, so that whatever ends this costs only those in flight. Raises OSError, and what
    the sandbox raises.
    """
    recipe = f"{_VERSION} {contract_digest(contract)}"
    found = store.db.execute(
        "SELECT min(name), source, class FROM environments LEFT JOIN previews USING (source, class) "
        "WHERE recipe IS NOT ? AND coalesce(verdict, 0) NOT IN "
        "(SELECT verdict FROM findings WHERE rule_check = 'source' AND severity = 'error') "
        "AND coalesce((SELECT contract FROM verdicts JOIN settings ON settings.id = verdicts.settings "
        "WHERE verdicts.id = environments.verdict), ?) = ? GROUP BY source, class ORDER BY 1",
        (recipe, otherwise, contract.name),
    )
    pending = [Environment(*row) for row in found]
    if not pending:
        return 0
    made: dict[str, bytes] = {}
    targets = stored(store, pending)
    plan = Plan(targets, contract, driver, [_Preview(made.__setitem__)], BUDGETS["quick"], limits=_LIMITS)
    told = time.monotonic()
    with Pool(driver, _LIMITS, len(pending)) as pool, contextlib.closing(stream(plan, workers, pool)) as events:
        done = 0
        for number, event in events:
            if not isinstance(event, SubjectFinished):
                continue
            environment, done = pending[number - 1], done + 1
            data = made.pop(environment.name, None)
            # What the sandbox could not do is tried again the next time.
            if event.report.verdict is not Verdict.ERROR:
                record(store, environment, recipe, data)
            if time.monotonic() - told > _TELL_EVERY:
                told = time.monotonic()
                click.echo(f"{done:,} of {len(pending):,} previews", err=True)
    _prune(store)
    return len(pending)


def record(store: Store, environment: Environment, recipe: str, data: bytes | None) -> None:
    """Write down an environment's preview, None where it shows none. Raises OSError."""
    sha256 = None
    if data is not None:
        sha256 = hashlib.sha256(data).hexdigest()
        if not place(store, sha256).exists():
            store.keep(place(store, sha256), data)
    store.db.execute(
        "INSERT OR REPLACE INTO previews VALUES (?, ?, ?, ?)",
        (environment.source, environment.env_class, recipe, sha256),
    )


def _prune(store: Store) -> None:
    """Forget the previews of what is no longer in the corpus."""
    store.db.execute(
        "DELETE FROM previews WHERE NOT EXISTS (SELECT 1 FROM environments "
        "WHERE environments.source = previews.source AND environments.class = previews.class)"
    )
    for file in files(store):
        if not _named(store, file):
            file.unlink(missing_ok=True)


def files(store: Store) -> list[Path]:
    """Everything that lies among the previews."""
    return sorted(file for file in (store.root / MEDIA).rglob("*") if file.is_file())


def _named(store: Store, file: Path) -> bool:
    named = store.db.execute("SELECT 1 FROM previews WHERE media = ? LIMIT 1", (file.stem,)).fetchone()
    return named is not None and file == place(store, file.stem)


def verify(store: Store, repair: bool) -> Iterator[str]:
    """What is wrong with the previews, in words; with `repair` it is taken out, for the next report to make anew."""
    for file in files(store):
        name = file.relative_to(store.root)
        if not _named(store, file):
            words = f"{name} belongs to no environment"
        elif (sha256 := hashlib.sha256(file.read_bytes()).hexdigest()) != file.stem:
            words = f"{name} has the digest {sha256}"
        else:
            continue
        if repair:
            file.unlink()
        yield words
    for source, sha256 in store.db.execute("SELECT source, media FROM previews WHERE media IS NOT NULL").fetchall():
        if place(store, sha256).is_file():
            continue
        if repair:
            store.db.execute("DELETE FROM previews WHERE media = ?", (sha256,))
        yield f"the preview of source {source[:12]} is missing"
