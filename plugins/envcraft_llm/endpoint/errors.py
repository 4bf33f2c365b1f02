"""Classification of an endpoint's errors: retry the attempt, fail the request, or stop the run."""

from __future__ import annotations

import email.utils
import random
import re
import time
from collections.abc import Mapping

from envcraft_llm.model import FailureKind, ModelUnavailable, Request, RequestFailed

from .response import excerpt

#: Longest pause in seconds: that an endpoint may ask for, and between attempts otherwise.
_MAX_RETRY_AFTER, _MAX_BACKOFF = 300.0, 60.0
_CONTEXT_OVERFLOW = re.compile(
    r"context[_ ](length|size|window)|exceed_context|maximum context|too many tokens|prompt is too long|"
    r"input (is )?too long|longer than the (maximum|context)|reduce the length",
    re.IGNORECASE,
)
_NO_MODEL = re.compile(
    r"model_not_found|model.{0,200}?(not found|does(n.t| not) exist|not exist|is not (available|served|loaded))|"
    r"(unknown|invalid|no such) model",
    re.IGNORECASE | re.DOTALL,
)
_CONTENT_FILTER = re.compile(r"content[_ ]?(filter|policy|management)|safety system|moderation", re.IGNORECASE)
_QUOTA = re.compile(r"insufficient_quota|exceeded your current quota|insufficient (credit|fund|balance)", re.IGNORECASE)
#: llama.cpp's message if the model did not follow the grammar of a schema.
_GRAMMAR_VIOLATED = re.compile(r"output that does not match the expected", re.IGNORECASE)
#: Parameters that an endpoint may not support, by the words of its error message.
_PARAMETERS = {
    "response_format": re.compile(
        r"response_format|json_schema|json schema|grammar|guided|structured output", re.IGNORECASE
    ),
    "reasoning_effort": re.compile(r"reasoning[_ ]effort", re.IGNORECASE),
    "stream_options": re.compile(r"stream_options|include_usage", re.IGNORECASE),
    "temperature": re.compile(r"temperature", re.IGNORECASE),
    "max_tokens": re.compile(r"max_tokens", re.IGNORECASE),
}


class RetryableError(Exception):
    """An attempt failed, and another one may succeed.

    Attributes:
        kind: The kind of failure of the request if no attempt succeeds.
        retry_after: Seconds that the endpoint asks to wait, or None.
        rate_limited: Whether the endpoint rejected the request because of its load.
        unreachable: Whether nothing listens at the address.
    """

    def __init__(
        self,
        kind: FailureKind,
        message: str,
        retry_after: float | None = None,
        rate_limited: bool = False,
        unreachable: bool = False,
    ) -> None:
        super().__init__(message)
        self.kind, self.retry_after = kind, retry_after
        self.rate_limited, self.unreachable = rate_limited, unreachable

    def backoff(self, attempt: int) -> float:
        """Return how many seconds to wait after an attempt.

        That is `retry_after` and up to a tenth more, or else exponential backoff with jitter, so that clients do not
        retry in step.

        Args:
            attempt: Number of the failed attempt, from 0.
        """
        if self.retry_after is not None:
            return self.retry_after * random.uniform(1.0, 1.1)
        return random.uniform(0.25, 1.0) * min(_MAX_BACKOFF, 2.0**attempt)


class UnsupportedParameter(Exception):
    """The endpoint does not support the parameter `name`."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


def error_from_response(
    status: int, body: str, headers: Mapping[str, str], request: Request, sent: Mapping[str, object]
) -> Exception:
    """Classify an HTTP error.

    Args:
        status: HTTP status.
        body: Body of the response as text, without the key.
        headers: Headers of the response.
        request: The request that failed.
        sent: Parameters of the request as sent.

    Returns:
        A RetryableError, UnsupportedParameter, RequestFailed or ModelUnavailable.
    """
    message = f"HTTP {status}: {excerpt(body) or 'no reason'}"
    if status == 402 or _QUOTA.search(body):
        return ModelUnavailable(f"the account at the endpoint has no credit left ({message})")
    if status in (401, 403):
        return ModelUnavailable(f"the endpoint rejects the key ({message})")
    if status in (408, 409, 425, 429) or status >= 500:
        kind: FailureKind = (
            "timeout" if status == 408 else "garbage" if _GRAMMAR_VIOLATED.search(body) else "server-error"
        )
        if status >= 500 and _CONTEXT_OVERFLOW.search(body):
            return RequestFailed("context-overflow", message)
        return RetryableError(kind, message, retry_after(headers), rate_limited=status in (429, 503, 529))
    if _CONTEXT_OVERFLOW.search(body) or status == 413:
        return RequestFailed("context-overflow", message)
    if _CONTENT_FILTER.search(body):
        return RequestFailed("refused", message)
    if status in (400, 404, 422) and _NO_MODEL.search(body):
        return ModelUnavailable(f"the endpoint has no model {request.model!r} ({message})")
    if status in (404, 405):
        return ModelUnavailable(f"the endpoint has no /chat/completions; most addresses end in /v1 ({message})")
    for name, pattern in _PARAMETERS.items():
        if name in sent and pattern.search(body):
            return UnsupportedParameter(name)
    return RequestFailed("server-error", message)


def retry_after(headers: Mapping[str, str]) -> float | None:
    """Return how many seconds the headers ask to wait, at most 300; None if they do not say."""
    for name, unit in (("retry-after-ms", 1e-3), ("retry-after", 1.0)):
        value = headers.get(name, "")
        try:
            seconds = float(value) * unit
        except ValueError:
            date = email.utils.parsedate_tz(value)
            if date is None:
                continue
            seconds = email.utils.mktime_tz(date) - time.time()
        # False for NaN.
        if seconds >= 0:
            return min(seconds, _MAX_RETRY_AFTER)
    return None
