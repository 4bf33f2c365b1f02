"""The model ``demo``: recorded answers, so that the whole pipeline runs without an endpoint.

The answers that ship are in ``demo.jsonl.gz``: one JSON object per concept, with its ``number``, its id (``concept``)
and its ``files`` (text by file name). To inspect or change an answer, unpack the archive, edit the files, replay the
folder, and pack it again::

    python -m envcraft_llm.recorded unpack answers/
    envcraft generate --model demo:answers
    python -m envcraft_llm.recorded pack answers/

The unpacked folder has one folder per concept, ``NN_<id>``, with ``brief.md`` (and optionally ``elaboration.md``),
``viability.json``, ``attempt_0.py`` and its repairs ``attempt_1.py`` to ``attempt_3.py``, and ``policy_0.py`` to
``policy_3.py``. A missing attempt is answered with the last earlier one. No verdict is recorded: the checker judges.
``expected.txt`` is the outcome that the test suite expects; the model does not read it.
"""

from __future__ import annotations

import argparse
import gzip
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from envcraft.errors import UsageError
from envcraft.files import atomic_write

from .concepts.generation import concepts
from .concepts.writing import Concept
from .model import Completion, Model, Request, RequestFailed

#: The recorded answers that ship.
ARCHIVE = Path(__file__).parent / "demo.jsonl.gz"
#: The seed whose first concepts have recorded answers.
SEED = 0
_FOLDER_NAME = re.compile(r"(\d+)_([0-9a-f]+)")
_SUFFIXES = frozenset({".json", ".md", ".py", ".txt"})
_SINGLE_FILES = {"briefs": "brief.md", "elaboration": "elaboration.md", "viability": "viability.json"}
_NUMBERED_FILES = {"code": "attempt", "repair": "attempt", "privileged": "policy"}
_INTRODUCTIONS = {
    "code": "Here is the complete environment.",
    "repair": "The cause was found, and this is the repaired file.",
    "privileged": "This policy plays from the state of the game.",
}


class RecordedConcept(msgspec.Struct, frozen=True):
    """The recorded answers about one concept.

    Attributes:
        number: Position of the concept among those of the seed, from 0.
        concept: Id of the concept.
        files: Text by file name.
    """

    number: int
    concept: str
    files: dict[str, str]

    @property
    def folder(self) -> str:
        """Name of the folder that holds the files once they are unpacked."""
        return f"{self.number:02}_{self.concept}"


class RecordedModel(Model):
    """Answers by stage, concept and attempt from recorded files.

    Args:
        path: An archive or an unpacked folder.

    Raises:
        UsageError: If `path` holds no recorded answers.
    """

    def __init__(self, path: Path = ARCHIVE) -> None:
        self._files = {recorded.concept: recorded.files for recorded in load(path)}
        if not self._files:
            raise UsageError(f"{path} holds no recorded answers: it needs folders such as 00_32c62bc38e25ac99")

    async def generate(self, request: Request) -> Completion:
        """Return the recorded answer.

        Raises:
            RequestFailed: If no answer is recorded for the request.
        """
        text = _answer(self._files.get(request.concept, {}), request)
        if not text:
            message = f"the demo has no answer for the stage {request.stage} of the concept {request.concept}"
            raise RequestFailed("empty", message)
        return Completion(text, model="demo")


def recorded_concepts(path: Path = ARCHIVE) -> list[Concept]:
    """Return the concepts that have recorded answers, in order.

    Raises:
        UsageError: If `path` cannot be read, or names a concept that the seed does not have at that number.
    """
    loaded = load(path)
    generated = list(concepts(max((recorded.number for recorded in loaded), default=-1) + 1, SEED)) if loaded else []
    for recorded in loaded:
        if generated[recorded.number].id != recorded.concept:
            expected = generated[recorded.number].id
            raise UsageError(
                f"{path / recorded.folder} does not match seed {SEED}: concept number {recorded.number} is {expected}"
            )
    return [generated[recorded.number] for recorded in loaded]


def load(path: Path) -> list[RecordedConcept]:
    """Read recorded answers from an archive or from an unpacked folder; an empty list if there are none.

    Raises:
        UsageError: If a file cannot be read.
    """
    try:
        if path.is_file():
            return [
                msgspec.json.decode(line, type=RecordedConcept)
                for line in gzip.decompress(path.read_bytes()).splitlines()
            ]
        return list(_load_folder(path))
    except (OSError, EOFError, UnicodeDecodeError, msgspec.DecodeError) as error:
        raise UsageError(f"{path} cannot be read as recorded answers: {error}") from None


def unpack(archive: Path, folder: Path) -> None:
    """Write the files of an archive below `folder`. Raises OSError, UsageError."""
    for recorded in load(archive):
        place = folder / recorded.folder
        place.mkdir(parents=True, exist_ok=True)
        for name, text in recorded.files.items():
            (place / name).write_text(text, "utf-8", newline="")


def pack(folder: Path, archive: Path) -> None:
    """Write the files of an unpacked folder to an archive; equal files give equal bytes. Raises OSError, UsageError."""
    lines = b"".join(msgspec.json.encode(recorded) + b"\n" for recorded in load(folder))
    # Without the time, which gzip would store in its header.
    with atomic_write(archive) as stream:
        stream.write(gzip.compress(lines, 9, mtime=0))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m envcraft_llm.recorded``."""
    parser = argparse.ArgumentParser(prog="python -m envcraft_llm.recorded", description="Unpack or pack demo answers.")
    parser.add_argument("command", choices=["unpack", "pack"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--archive", type=Path, default=ARCHIVE, help="the archive; by default the one that ships")
    options = parser.parse_args(arguments)
    if options.command == "unpack":
        unpack(options.archive, options.folder)
    else:
        pack(options.folder, options.archive)
    return 0


def _load_folder(folder: Path) -> Iterator[RecordedConcept]:
    for place in sorted(folder.iterdir()) if folder.is_dir() else ():
        if (name := _FOLDER_NAME.fullmatch(place.name)) and place.is_dir():
            files = {file.name: file.read_text("utf-8") for file in sorted(place.iterdir()) if file.suffix in _SUFFIXES}
            yield RecordedConcept(int(name[1]), name[2], files)


def _answer(files: dict[str, str], request: Request) -> str:
    """The recorded answer, or "" if there is none."""
    if single := _SINGLE_FILES.get(request.stage):
        return files.get(single, "")
    kind = _NUMBERED_FILES.get(request.stage)
    for number in range(request.attempt, -1, -1) if kind else ():
        if source := files.get(f"{kind}_{number}.py"):
            return f"{_INTRODUCTIONS[request.stage]}\n\n```python\n{source.rstrip()}\n```\n"
    return ""


if __name__ == "__main__":
    raise SystemExit(main())
