"""Usage of a run: requests, tokens and cost by stage, and the limits that end the run."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from envcraft_llm.model import ModelUnavailable, Request

from .settings import ModelSettings, Price

#: Seconds over which the token rate is averaged.
_RATE_WINDOW = 60.0
#: Average characters per token of English text and code.
_CHARACTERS_PER_TOKEN = 4


class BudgetExceeded(ModelUnavailable):
    """A limit on cost, tokens or time is reached: no request is sent any more, and those in flight complete."""


@dataclass
class Usage:
    """Usage of one stage.

    Attributes:
        attempts: Requests sent to the endpoint, retries included.
        replayed: Requests that the journal answered.
        retries: Attempts after the first.
        failures: Failed requests by kind.
        prompt_tokens: Tokens of prompts, as the endpoint counts them.
        completion_tokens: Tokens of completions; those of an interrupted attempt are estimated.
        cost: Cost by the configured prices.
        seconds: Response time summed over all requests.
    """

    attempts: int = 0
    replayed: int = 0
    retries: int = 0
    failures: Counter[str] = field(default_factory=Counter)
    prompt_tokens: int = 0
    completion_tokens: int = 0
    cost: float = 0.0
    seconds: float = 0.0

    @property
    def tokens(self) -> int:
        return self.prompt_tokens + self.completion_tokens

    def add(self, other: Usage) -> None:
        """Add the usage of another stage."""
        for name in ("attempts", "replayed", "retries", "prompt_tokens", "completion_tokens", "cost", "seconds"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.failures.update(other.failures)


class Reservation(NamedTuple):
    """Expected usage of requests in flight."""

    tokens: float
    cost: float


class UsageTracker:
    """Usage by stage, and the expected usage of requests in flight.

    Attributes:
        by_stage: Usage by stage, in the order of the first request of each.
        prices: Prices by name of the model.
    """

    def __init__(self, settings: ModelSettings) -> None:
        self.by_stage: dict[str, Usage] = {}
        self.prices: Mapping[str, Price] = settings.prices
        self._settings = settings
        self._start = time.monotonic()
        self._recent: deque[tuple[float, int]] = deque()
        self._reserved = Reservation(0, 0)
        self._tokens, self._cost = 0, 0.0
        # Attempts that used tokens, by stage.
        self._paid: Counter[str] = Counter()

    @property
    def total(self) -> Usage:
        """Usage of all stages."""
        total = Usage()
        for usage in self.by_stage.values():
            total.add(usage)
        return total

    @property
    def tokens_per_second(self) -> float:
        """Completion tokens per second over the last minute."""
        now = time.monotonic()
        self._drop_old(now)
        return sum(tokens for _, tokens in self._recent) / max(min(_RATE_WINDOW, now - self._start), 1e-9)

    def of(self, stage: str) -> Usage:
        """Return the usage of a stage, which the caller may update."""
        return self.by_stage.setdefault(stage, Usage())

    def reserve(self, request: Request) -> Reservation:
        """Reserve the average usage of the request's stage.

        Raises:
            BudgetExceeded: If the request may exceed a limit.
        """
        limits = self._settings
        if limits.max_seconds is not None and time.monotonic() - self._start >= limits.max_seconds:
            raise BudgetExceeded(
                f"the time limit of {limits.max_seconds:g} s is reached; run the same command again to continue"
            )
        tokens, cost = self._expected(request)
        if (
            limits.max_tokens_total is not None
            and self._tokens + self._reserved.tokens + tokens > limits.max_tokens_total
        ):
            raise BudgetExceeded(
                f"{self._tokens:,} tokens are used, about {self._reserved.tokens:,.0f} are in flight, and one more "
                f"request may exceed the limit of {limits.max_tokens_total:,}; run the same command again to continue"
            )
        if limits.max_cost is not None and self._cost + self._reserved.cost + cost > limits.max_cost:
            raise BudgetExceeded(
                f"{self._cost:,.4g} are spent, about {self._reserved.cost:,.4g} are in flight, and one more request "
                f"may exceed the limit of {limits.max_cost:,.4g}; run the same command again to continue"
            )
        self._reserved = Reservation(self._reserved.tokens + tokens, self._reserved.cost + cost)
        return Reservation(tokens, cost)

    def release(self, request: Request, reservation: Reservation) -> None:
        """Release the reservation of a request that has ended, and count the attempt."""
        self._reserved = Reservation(self._reserved.tokens - reservation.tokens, self._reserved.cost - reservation.cost)
        self.of(request.stage).attempts += 1

    def record(self, request: Request, prompt_tokens: int, completion_tokens: int, seconds: float) -> None:
        """Count the tokens and the seconds of one attempt."""
        usage, cost = self.of(request.stage), self._price(request.model, prompt_tokens, completion_tokens)
        usage.prompt_tokens += prompt_tokens
        usage.completion_tokens += completion_tokens
        usage.cost += cost
        usage.seconds += seconds
        self._paid[request.stage] += 1
        self._tokens += prompt_tokens + completion_tokens
        self._cost += cost
        now = time.monotonic()
        self._recent.append((now, completion_tokens))
        self._drop_old(now)

    def _drop_old(self, now: float) -> None:
        while self._recent and self._recent[0][0] < now - _RATE_WINDOW:
            self._recent.popleft()

    def _expected(self, request: Request) -> Reservation:
        usage = self.of(request.stage)
        if paid := self._paid[request.stage]:
            return Reservation(usage.tokens / paid, usage.cost / paid)
        prompt = estimated_prompt_tokens(request)
        return Reservation(prompt, self._price(request.model, prompt, 0))

    def _price(self, model: str, prompt_tokens: int, completion_tokens: int) -> float:
        price = self.prices.get(model, Price())
        return (prompt_tokens * price.prompt + completion_tokens * price.completion) / 1e6


def estimated_prompt_tokens(request: Request) -> int:
    """Estimate the tokens of a prompt from its length."""
    return sum(len(message.content) for message in request.messages) // _CHARACTERS_PER_TOKEN
