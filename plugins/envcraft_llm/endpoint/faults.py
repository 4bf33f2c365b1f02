"""What an error of an endpoint means: for one attempt, for the request, or for the whole run."""

from __future__ import annotations

import email.utils
import random
import re
import time
from collections.abc import Mapping

from envcraft_llm.model import FailureKind, ModelFailure, ModelStopped, Request

from .reading import shown

#: The longest wait that an endpoint may ask for, and the longest between attempts otherwise, in seconds.
_LONGEST_ASKED, _LONGEST = 300.0, 60.0
_OVERFLOW = re.compile(
    r"context[_ ](length|size|window)|exceed_context|maximum context|too many tokens|prompt is too long|"
    r"input (is )?too long|longer than the (maximum|context)|reduce the length",
    re.IGNORECASE,
)
_NO_MODEL = re.compile(
    r"model_not_found|model.{0,200}?(not found|does(n.t| not) exist|not exist|is not (available|served|loaded))|"
    r"(unknown|invalid|no such) model",
    re.IGNORECASE | re.DOTALL,
)
_FILTERED = re.compile(r"content[_ ]?(filter|policy|management)|safety system|moderation", re.IGNORECASE)
_SPENT = re.compile(r"insufficient_quota|exceeded your current quota|insufficient (credit|fund|balance)", re.IGNORECASE)
#: How llama.cpp says that the model kept to no form, such as that of a schema.
_UNREADABLE = re.compile(r"output that does not match the expected", re.IGNORECASE)
#: Parameters that an endpoint may refuse, by the words with which it does.
_PARAMETERS = {
    "response_format": re.compile(
        r"response_format|json_schema|json schema|grammar|guided|structured output", re.IGNORECASE
    ),
    "reasoning_effort": re.compile(r"reasoning[_ ]effort", re.IGNORECASE),
    "stream_options": re.compile(r"stream_options|include_usage", re.IGNORECASE),
    "temperature": re.compile(r"temperature", re.IGNORECASE),
    "max_tokens": re.compile(r"max_tokens", re.IGNORECASE),
}


class Again(Exception):
    """An attempt failed, and another may not.

    Attributes:
        kind: of the failure that it is in the end.
        after: how many seconds the endpoint asks to wait, if it does.
        limited: whether it was sent away because there are too many.
        down: whether there was no endpoint.
    """

    def __init__(
        self, kind: FailureKind, message: str, after: float | None = None, limited: bool = False, down: bool = False
    ) -> None:
        super().__init__(message)
        self.kind, self.after, self.limited, self.down = kind, after, limited, down

    def pause(self, attempt: int) -> float:
        """How many seconds to wait after the attempt of this number, from 0: full jitter over a doubling span, or what
        the endpoint asks for and a little more, so that not all come back at once.
        """
        if self.after is not None:
            return self.after * random.uniform(1.0, 1.1)
        return random.uniform(0.25, 1.0) * min(_LONGEST, 2.0**attempt)


class ParameterRefused(Exception):
    """The endpoint takes no parameter of this name."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


def fault(
    status: int, body: str, headers: Mapping[str, str], request: Request, sent: Mapping[str, object]
) -> Exception:
    """What an HTTP error of this status means: Again, ParameterRefused, ModelFailure or ModelStopped.

    Args:
        body: of the response, as text, without the key.
        sent: the parameters of the request as it was sent.
    """
    said = f"HTTP {status}: {shown(body) or 'no reason'}"
    if status == 402 or _SPENT.search(body):
        return ModelStopped(f"the account at the endpoint has nothing left ({said})")
    if status in (401, 403):
        return ModelStopped(f"the endpoint refuses the key ({said})")
    if status in (408, 409, 425, 429) or status >= 500:
        kind: FailureKind = "timeout" if status == 408 else "garbage" if _UNREADABLE.search(body) else "server-error"
        if status >= 500 and _OVERFLOW.search(body):
            return ModelFailure("context-overflow", said)
        return Again(kind, said, retry_after(headers), limited=status in (429, 503, 529))
    if _OVERFLOW.search(body) or status == 413:
        return ModelFailure("context-overflow", said)
    if _FILTERED.search(body):
        return ModelFailure("refused", said)
    if status in (400, 404, 422) and _NO_MODEL.search(body):
        return ModelStopped(f"the endpoint has no model {request.model!r} ({said})")
    if status in (404, 405):
        return ModelStopped(f"the endpoint has no /chat/completions; most addresses end in /v1 ({said})")
    for name, words in _PARAMETERS.items():
        if name in sent and words.search(body):
            return ParameterRefused(name)
    return ModelFailure("server-error", said)


def retry_after(headers: Mapping[str, str]) -> float | None:
    """How many seconds an endpoint asks to wait, at most 300; None where it says nothing that can be read."""
    for name, unit in (("retry-after-ms", 1e-3), ("retry-after", 1.0)):
        told = headers.get(name, "")
        try:
            seconds = float(told) * unit
        except ValueError:
            date = email.utils.parsedate_tz(told)
            if date is None:
                continue
            seconds = email.utils.mktime_tz(date) - time.time()
        # A comparison that is false for what is no number.
        if seconds >= 0:
            return min(seconds, _LONGEST_ASKED)
    return None
