"""Files of the OpenAI Batch interface: requests written for it, and answers read back.

A batch is three files in one folder: ``NAME.input.jsonl``, which the endpoint takes, ``NAME.requests.jsonl`` with the
same requests as EnvCraft knows them, and ``NAME.output.jsonl``, once there is one. The second is there as long as the
answers are not in the journal.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from envcraft.errors import EnvCraftError
from envcraft_llm.model import ModelFailure, ModelStopped, Request

from .accounts import estimate
from .faults import Again, ParameterRefused, fault
from .journal import Failed, Outcome
from .reading import Garbled, Reading, decode
from .wording import body

#: What one file may hold at most at the endpoints that have the interface.
REQUESTS, BYTES = 50_000, 100 * 2**20
INPUT, KNOWN, OUTPUT = ".input.jsonl", ".requests.jsonl", ".output.jsonl"


class Response(msgspec.Struct):
    status_code: int = 200
    body: msgspec.Raw = msgspec.Raw(b"null")


class Line(msgspec.Struct):
    """One line of an output file."""

    custom_id: str
    response: Response | None = None
    error: Any = None


_line, _request = msgspec.json.Decoder(Line), msgspec.json.Decoder(Request)


class Output(NamedTuple):
    """What came of a batch.

    `outcomes` has requests with what came of them and the tokens of prompt and answer, `stopped` why none of the others
    can be answered, if the endpoint told so.
    """

    outcomes: list[tuple[Request, Outcome, tuple[int, int]]]
    stopped: ModelStopped | None


def write_batches(requests: Iterable[Request], folder: Path, refused: Mapping[str, Collection[str]] = {}) -> list[str]:
    """Write requests as batches, each of one model and within the bounds of the interface; gives their names.

    Args:
        requests: no two the same.
        folder: made where it does not exist.
        refused: the parameters that are left out, by the name of the model.

    Raises EnvCraftError where the files cannot be written.
    """
    by_model: dict[str, list[tuple[bytes, Request]]] = {}
    for request in requests:
        told = body(request, refused.get(request.model, ()), stream=False)
        line = {"custom_id": request.key(), "method": "POST", "url": "/v1/chat/completions", "body": told}
        by_model.setdefault(request.model, []).append((msgspec.json.encode(line), request))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [_write(part, folder) for lines in by_model.values() for part in _parts(lines)]
    except OSError as error:
        raise EnvCraftError(f"batches cannot be written to {folder}: {error}") from None


def outstanding(folder: Path) -> list[str]:
    """The names of the batches whose answers are not in the journal."""
    return sorted(path.name.removesuffix(KNOWN) for path in folder.glob(f"*{KNOWN}"))


def known(folder: Path, name: str) -> dict[str, Request]:
    """The requests of a batch, by key. Raises EnvCraftError where they cannot be read."""
    path = folder / f"{name}{KNOWN}"
    try:
        requests = [_request.decode(line) for line in path.read_bytes().splitlines()]
    except (OSError, msgspec.DecodeError) as error:
        raise EnvCraftError(f"{path} cannot be read: {error}") from None
    return {request.key(): request for request in requests}


def read_output(
    output: Path, requests: Mapping[str, Request], refused: dict[str, set[str]], plain: Callable[[str], str] = str
) -> Output:
    """What came of requests by an output file, whose lines `plain` rids of the key. Lines of other requests, and lines
    that are none beside some that are, are passed over; a request whose parameter the endpoint does not take is left
    out, and the parameter added to `refused`.

    Raises EnvCraftError where the file cannot be read, or is no such file.
    """
    found = Output([], None)
    wrong, lines = "", 0
    try:
        with output.open("rb") as file:
            for number, line in enumerate(file, 1):
                if not line.strip():
                    continue
                try:
                    told = _line.decode(plain(line.decode()))
                except (msgspec.DecodeError, UnicodeDecodeError) as error:
                    wrong = wrong or f"{output}, line {number}: {error}"
                    continue
                lines += 1
                if (request := requests.get(told.custom_id)) is None:
                    continue
                try:
                    found.outcomes.append((request, *_outcome(request, told)))
                except ParameterRefused as parameter:
                    refused.setdefault(request.model, set()).add(parameter.name)
                except ModelStopped as stopped:
                    found = found._replace(stopped=found.stopped or stopped)
    except OSError as error:
        raise EnvCraftError(f"{output} cannot be read: {error}") from None
    if wrong and not lines:
        raise EnvCraftError(wrong)
    return found


def _outcome(request: Request, line: Line) -> tuple[Outcome, tuple[int, int]]:
    """Raises ParameterRefused and ModelStopped."""
    reading = Reading()
    try:
        if line.response is None or line.error is not None:
            raise Again("server-error", f"the batch has no answer: {line.error}")
        told = bytes(line.response.body)
        if line.response.status_code != 200:
            sent = body(request, stream=False)
            raise fault(line.response.status_code, told.decode("utf-8", "replace"), {}, request, sent)
        reading.take(decode(told))
        tokens = reading.tokens(estimate(request))
        return reading.answer(tokens, 0.0), tokens
    except Again as again:
        return Failed(again.kind, str(again)), (0, 0)
    except Garbled as garbled:
        return Failed("garbage", str(garbled)), (0, 0)
    except ModelFailure as failure:
        return Failed(failure.kind, str(failure)), reading.tokens(0)


def _parts(lines: list[tuple[bytes, Request]]) -> Iterator[list[tuple[bytes, Request]]]:
    part: list[tuple[bytes, Request]] = []
    size = 0
    for line in lines:
        if part and (len(part) == REQUESTS or size + len(line[0]) + 1 > BYTES):
            yield part
            part, size = [], 0
        part.append(line)
        size += len(line[0]) + 1
    if part:
        yield part


def _write(part: list[tuple[bytes, Request]], folder: Path) -> str:
    """Raises OSError. What tells that a batch is outstanding comes last."""
    digest = hashlib.sha256(b"".join(line for line, _ in part)).hexdigest()[:16]
    # The same requests may have been sent before, and not all answered.
    names = itertools.chain([digest], (f"{digest}-{again}" for again in itertools.count(2)))
    name = next(name for name in names if not (folder / f"{name}{INPUT}").exists())
    for suffix, lines in (
        (INPUT, (line for line, _ in part)),
        (KNOWN, (msgspec.json.encode(asked) for _, asked in part)),
    ):
        unfinished = folder / f"{name}{suffix}.part"
        unfinished.write_bytes(b"".join(line + b"\n" for line in lines))
        unfinished.replace(folder / f"{name}{suffix}")
    return name
