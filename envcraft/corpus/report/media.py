"""Previews of environments: a few frames of one random episode each, one below the other in one small file.

Each source is played once, in the sandbox. The files are stored in the corpus by the digest of their contents.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.corpus.audit import stored_targets
from envcraft.corpus.store import Environment, Store, previews
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver, Limits
from envcraft.judging.engine import Plan, stream
from envcraft.judging.frame_renderer import frames_of, rgb, with_frames
from envcraft.judging.settings import contract_digest
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.contract import Contract
from envcraft.model.events import SubjectFinished
from envcraft.model.rollout import Conditions
from envcraft.model.verdict import Finding, Verdict

MEDIA = "media"
#: The side of a frame in pixels, the frames of a preview, and the steps of the episode that they are from.
SIDE, FRAMES, STEPS = 84, 12, 60
#: The maximum size of a preview in bytes.
MAX_BYTES = 10 * 1024
#: Frames and quality to try in turn until a preview is small enough; the quality None is lossless.
_CODINGS: tuple[tuple[int, int | None], ...] = ((FRAMES, None), (FRAMES, 60), (FRAMES, 25), (6, 25), (3, 10), (1, 0))
#: Part of the recipe; another version makes all previews again.
_VERSION = 1
_LIMITS = Limits(job=20.0)
#: Seconds for the preview of one environment.
_SECONDS = 40.0
_MESSAGE_EVERY = 15.0


class _Preview(Check):
    """Judges nothing: plays a few steps with sticky random actions and passes the encoded frames to a function."""

    name = "preview"
    rules = ()

    def __init__(self, take: Callable[[str, bytes], object]) -> None:
        self._take = take

    def judge(self, subject: Subject) -> Iterator[Finding]:
        conditions = with_frames(subject, Conditions())
        rollout = subject.probes.sticky(0).cut(STEPS).under(conditions)
        # Not cached, because no check needs this rollout again.
        trace = subject.rerun(msgspec.structs.replace(rollout, keep=STEPS + 1))
        frames = [picture for frame in frames_of(trace) if (picture := rgb(frame)) is not None]
        if frames:
            self._take(subject.target.path, encode(frames))
        return iter(())


def pillow() -> Any:
    """The module ``PIL.Image``; None if Pillow cannot write WebP."""
    from PIL import Image, features

    return Image if features.check("webp") else None


def encode(frames: Sequence[NDArray[np.uint8]]) -> bytes:
    """Encode some frames as one WebP file, one square below the other. Needs a Pillow that can write WebP.

    Args:
        frames: RGB frames, each of shape (height, width, 3).

    Returns:
        A file of at most `MAX_BYTES` bytes, `SIDE` pixels wide.
    """
    image = pillow()
    data = b""
    for count, quality in _CODINGS:
        picked = np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int)
        strip = np.vstack([_square(image, frames[place]) for place in picked])
        written = io.BytesIO()
        image.fromarray(strip).save(written, "WEBP", lossless=quality is None, quality=quality or 0, method=4)
        data = written.getvalue()
        if len(data) <= MAX_BYTES:
            break
    return data


def _square(image: Any, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Scale a frame to fit a square of `SIDE` pixels, centred on black."""
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
    """The path of a preview, whether it exists or not."""
    return store.root / MEDIA / sha256[:2] / f"{sha256}.webp"


def preview(store: Store, environment: Environment) -> Path | None:
    """The file of an environment's preview; None if there is none."""
    sha256 = previews.media(store, environment)
    file = None if sha256 is None else place(store, sha256)
    return file if file is not None and file.is_file() else None


def make(
    store: Store,
    contract: Contract,
    default: str,
    driver: Driver,
    workers: int | None = None,
    message: Callable[[str], None] = lambda text: None,
) -> int:
    """Make the missing previews of environments whose last verdict is under a contract.

    Environments that the check `source` refused have none. Each preview is stored as soon as it is made.

    Args:
        store: the corpus, open for writing.
        contract: the contract.
        default: the name of the contract of environments without a verdict.
        driver: the sandbox driver.
        workers: how many environments to play at the same time; None for as many as there are cores.
        message: called with each line about the progress.

    Returns:
        How many environments were played.

    Raises:
        OSError: if a preview cannot be written.
        EnvCraftError: if the sandbox does not work.
    """
    recipe = f"{_VERSION} {contract_digest(contract)}"
    pending = previews.pending(store, recipe, contract.name, default)
    if not pending:
        return 0
    made: dict[str, bytes] = {}
    targets = stored_targets(store, pending)
    plan = Plan(
        targets, contract, driver, [_Preview(made.__setitem__)], BUDGETS["quick"], limits=_LIMITS, time_limit=_SECONDS
    )
    last = time.monotonic()
    with WorkerPool(driver, _LIMITS, len(pending)) as pool, contextlib.closing(stream(plan, workers, pool)) as events:
        done = 0
        for number, event in events:
            if not isinstance(event, SubjectFinished):
                continue
            environment, done = pending[number - 1], done + 1
            data = made.pop(environment.name, None)
            # An environment that could not be played is tried again by the next report.
            if event.report.verdict is not Verdict.ERROR:
                record(store, environment, recipe, data)
            if time.monotonic() - last > _MESSAGE_EVERY:
                last = time.monotonic()
                message(f"{done:,} of {len(pending):,} previews")
    _prune(store)
    return len(pending)


def record(store: Store, environment: Environment, recipe: str, data: bytes | None) -> None:
    """Store an environment's preview; None if it shows no picture.

    Raises:
        OSError: if the file cannot be written.
    """
    sha256 = None
    if data is not None:
        sha256 = hashlib.sha256(data).hexdigest()
        if not place(store, sha256).exists():
            store.keep(place(store, sha256), data)
    previews.record(store, environment, recipe, sha256)


def _prune(store: Store) -> None:
    """Delete the previews of sources that the corpus no longer has."""
    previews.prune(store)
    for file in files(store):
        if not _is_referenced(store, file):
            file.unlink(missing_ok=True)


def files(store: Store) -> list[Path]:
    """All files in the folder of previews, sorted."""
    return sorted(file for file in (store.root / MEDIA).rglob("*") if file.is_file())


def _is_referenced(store: Store, file: Path) -> bool:
    return previews.is_referenced(store, file.stem) and file == place(store, file.stem)


def verify(store: Store, repair: bool) -> Iterator[str]:
    """Yield what is wrong with the previews; with `repair`, remove it."""
    for file in files(store):
        name = file.relative_to(store.root)
        if not _is_referenced(store, file):
            words = f"{name} belongs to no environment"
        elif (sha256 := hashlib.sha256(file.read_bytes()).hexdigest()) != file.stem:
            words = f"{name} has the digest {sha256}"
        else:
            continue
        if repair:
            file.unlink()
        yield words
    for source, sha256 in previews.rows(store):
        if place(store, sha256).is_file():
            continue
        if repair:
            previews.forget(store, sha256)
        yield f"the preview of source {source[:12]} is missing"
