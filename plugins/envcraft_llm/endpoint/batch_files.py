"""Files of the Batch interface: requests to send, and results to read.

A batch is three files in one folder: ``NAME.input.jsonl``, which the endpoint reads; ``NAME.requests.jsonl`` with the
same requests as `Request` objects; and ``NAME.output.jsonl``, once the batch has ended. The second file exists until
the results are in the journal.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from envcraft.errors import EnvCraftError
from envcraft.files import atomic_write
from envcraft_llm.model import ModelUnavailable, Request, RequestFailed

from .errors import RetryableError, UnsupportedParameter, error_from_response
from .journal import Failure, Result
from .request_body import request_body
from .response import CompletionBuilder, MalformedResponse, decode_chunk
from .usage import estimated_prompt_tokens

#: Limits of one input file: requests, and bytes.
MAX_REQUESTS, MAX_BYTES = 50_000, 100 * 2**20
INPUT, REQUESTS, OUTPUT = ".input.jsonl", ".requests.jsonl", ".output.jsonl"


class BatchResponse(msgspec.Struct):
    status_code: int = 200
    body: msgspec.Raw = msgspec.Raw(b"null")


class OutputLine(msgspec.Struct):
    """One line of an output file."""

    custom_id: str
    response: BatchResponse | None = None
    error: Any = None


_line, _request = msgspec.json.Decoder(OutputLine), msgspec.json.Decoder(Request)


class Output(NamedTuple):
    """The content of an output file.

    Attributes:
        results: Requests with their results and the tokens of prompt and completion.
        unavailable: Why no other request can succeed, if a line says so.
    """

    results: list[tuple[Request, Result, tuple[int, int]]]
    unavailable: ModelUnavailable | None


def write_batches(
    requests: Iterable[Request], folder: Path, unsupported: Mapping[str, Collection[str]] = {}
) -> list[str]:
    """Write requests as batches, each of one model and within the limits of the interface.

    Args:
        requests: Distinct requests.
        folder: Folder of the batch files; created if it does not exist.
        unsupported: Unsupported parameters by name of the model.

    Returns:
        The names of the batches.

    Raises:
        EnvCraftError: If the files cannot be written.
    """
    by_model: dict[str, list[tuple[bytes, Request]]] = {}
    for request in requests:
        body = request_body(request, unsupported.get(request.model, ()), stream=False)
        line = {"custom_id": request.key(), "method": "POST", "url": "/v1/chat/completions", "body": body}
        by_model.setdefault(request.model, []).append((msgspec.json.encode(line), request))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [_write(part, folder) for lines in by_model.values() for part in _parts(lines)]
    except OSError as error:
        raise EnvCraftError(f"batches cannot be written to {folder}: {error}") from None


def outstanding(folder: Path) -> list[str]:
    """Return the names of the batches whose results are not in the journal."""
    return sorted(path.name.removesuffix(REQUESTS) for path in folder.glob(f"*{REQUESTS}"))


def load_requests(folder: Path, name: str) -> dict[str, Request]:
    """Return the requests of a batch by key.

    Raises:
        EnvCraftError: If their file cannot be read.
    """
    path = folder / f"{name}{REQUESTS}"
    try:
        requests = [_request.decode(line) for line in path.read_bytes().splitlines()]
    except (OSError, msgspec.DecodeError) as error:
        raise EnvCraftError(f"{path} cannot be read: {error}") from None
    return {request.key(): request for request in requests}


def read_output(
    output: Path, requests: Mapping[str, Request], unsupported: dict[str, set[str]], redact: Callable[[str], str] = str
) -> Output:
    """Read the results of requests from an output file.

    Lines about other requests are skipped, and so are malformed lines if at least one line is valid. A request with an
    unsupported parameter has no result.

    Args:
        output: The output file.
        requests: The requests of the batch by key.
        unsupported: Unsupported parameters by name of the model; this function adds to it.
        redact: Removes the key from a line.

    Raises:
        EnvCraftError: If the file cannot be read, or has no valid line.
    """
    parsed = Output([], None)
    malformed, valid = "", 0
    try:
        with output.open("rb") as file:
            for number, data in enumerate(file, 1):
                if not data.strip():
                    continue
                try:
                    line = _line.decode(redact(data.decode()))
                except (msgspec.DecodeError, UnicodeDecodeError) as error:
                    malformed = malformed or f"{output}, line {number}: {error}"
                    continue
                valid += 1
                if (request := requests.get(line.custom_id)) is None:
                    continue
                try:
                    parsed.results.append((request, *_result(request, line)))
                except UnsupportedParameter as parameter:
                    unsupported.setdefault(request.model, set()).add(parameter.name)
                except ModelUnavailable as unavailable:
                    parsed = parsed._replace(unavailable=parsed.unavailable or unavailable)
    except OSError as error:
        raise EnvCraftError(f"{output} cannot be read: {error}") from None
    if malformed and not valid:
        raise EnvCraftError(malformed)
    return parsed


def _result(request: Request, line: OutputLine) -> tuple[Result, tuple[int, int]]:
    """Raises UnsupportedParameter, ModelUnavailable."""
    builder = CompletionBuilder()
    try:
        if line.response is None or line.error is not None:
            raise RetryableError("server-error", f"the batch has no result: {line.error}")
        body = bytes(line.response.body)
        if line.response.status_code != 200:
            sent = request_body(request, stream=False)
            raise error_from_response(line.response.status_code, body.decode("utf-8", "replace"), {}, request, sent)
        builder.add(decode_chunk(body))
        tokens = builder.tokens(estimated_prompt_tokens(request))
        return builder.build(tokens, 0.0), tokens
    except RetryableError as error:
        return Failure(error.kind, str(error)), (0, 0)
    except MalformedResponse as malformed:
        return Failure("garbage", str(malformed)), (0, 0)
    except RequestFailed as failure:
        return Failure(failure.kind, str(failure)), builder.tokens(0)


def _parts(lines: list[tuple[bytes, Request]]) -> Iterator[list[tuple[bytes, Request]]]:
    part: list[tuple[bytes, Request]] = []
    size = 0
    for line in lines:
        if part and (len(part) == MAX_REQUESTS or size + len(line[0]) + 1 > MAX_BYTES):
            yield part
            part, size = [], 0
        part.append(line)
        size += len(line[0]) + 1
    if part:
        yield part


def _write(part: list[tuple[bytes, Request]], folder: Path) -> str:
    """Raises OSError."""
    digest = hashlib.sha256(b"".join(line for line, _ in part)).hexdigest()[:16]
    # An earlier batch may have had the same requests, without a result for all of them.
    names = itertools.chain([digest], (f"{digest}-{number}" for number in itertools.count(2)))
    name = next(name for name in names if not (folder / f"{name}{INPUT}").exists())
    # The requests last: their file marks the batch as outstanding.
    for suffix, lines in (
        (INPUT, (line for line, _ in part)),
        (REQUESTS, (msgspec.json.encode(request) for _, request in part)),
    ):
        with atomic_write(folder / f"{name}{suffix}") as file:
            file.writelines(line + b"\n" for line in lines)
    return name
