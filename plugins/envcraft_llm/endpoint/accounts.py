"""What a run uses: requests, tokens and cost by stage; and the limits at which it ends."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from envcraft_llm.model import ModelStopped, Request

from .settings import ModelChoice, Price

#: Over how many seconds the rate of tokens is told.
_WINDOW = 60.0
#: English text and code have about so many characters in a token.
_CHARACTERS = 4


class BudgetSpent(ModelStopped):
    """A limit of cost, tokens or time is reached: nothing more is asked, and what is under way still comes in."""


@dataclass
class Usage:
    """What one stage used.

    Attributes:
        asked: attempts that the endpoint answered or failed.
        replayed: requests that the journal answered.
        retries: attempts after the first.
        failures: requests that came to nothing, by kind.
        prompt_tokens, completion_tokens: as the endpoint counts them; an attempt that broke off is estimated.
        cost: by the prices of the settings.
        seconds: of answering, added up over all requests.
    """

    asked: int = 0
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
        """Count what the other counted."""
        for name in ("asked", "replayed", "retries", "prompt_tokens", "completion_tokens", "cost", "seconds"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.failures.update(other.failures)


class Reserved(NamedTuple):
    """What is expected of requests that are under way."""

    tokens: float
    cost: float


class Accounts:
    """Usage by stage, and what a request is expected to use.

    Attributes:
        by_stage: in the order in which stages first asked.
        prices: by the name of the model.
    """

    def __init__(self, choice: ModelChoice) -> None:
        self.by_stage: dict[str, Usage] = {}
        self.prices: Mapping[str, Price] = choice.prices
        self._choice = choice
        self._began = time.monotonic()
        self._recent: deque[tuple[float, int]] = deque()
        self._held = Reserved(0, 0)
        self._tokens, self._cost = 0, 0.0
        # Attempts that used tokens, by stage.
        self._paid: Counter[str] = Counter()

    @property
    def total(self) -> Usage:
        """Over all stages."""
        total = Usage()
        for usage in self.by_stage.values():
            total.add(usage)
        return total

    @property
    def tokens_per_second(self) -> float:
        """Of answers, over the last minute."""
        now = time.monotonic()
        self._forget(now)
        return sum(tokens for _, tokens in self._recent) / max(min(_WINDOW, now - self._began), 1e-9)

    def of(self, stage: str) -> Usage:
        """The usage of a stage, to be added to."""
        return self.by_stage.setdefault(stage, Usage())

    def reserve(self, request: Request) -> Reserved:
        """Count a request as under way, with what those of its stage used on average. Raises BudgetSpent where that
        would pass a limit.
        """
        choice = self._choice
        if choice.max_seconds is not None and time.monotonic() - self._began >= choice.max_seconds:
            raise BudgetSpent(f"the time limit of {choice.max_seconds:g} s is reached; a later run goes on from here")
        tokens, cost = self._expect(request)
        if choice.max_tokens_total is not None and self._tokens + self._held.tokens + tokens > choice.max_tokens_total:
            raise BudgetSpent(
                f"{self._tokens:,} tokens are used, about {self._held.tokens:,.0f} are under way, and one more request "
                f"may pass the limit of {choice.max_tokens_total:,}; a later run goes on from here"
            )
        if choice.max_cost is not None and self._cost + self._held.cost + cost > choice.max_cost:
            raise BudgetSpent(
                f"{self._cost:,.4g} are spent, about {self._held.cost:,.4g} are under way, and one more request may "
                f"pass the limit of {choice.max_cost:,.4g}; a later run goes on from here"
            )
        self._held = Reserved(self._held.tokens + tokens, self._held.cost + cost)
        return Reserved(tokens, cost)

    def settle(self, request: Request, reserved: Reserved) -> None:
        """The request is under way no more."""
        self._held = Reserved(self._held.tokens - reserved.tokens, self._held.cost - reserved.cost)
        self.of(request.stage).asked += 1

    def use(self, request: Request, prompt_tokens: int, completion_tokens: int, seconds: float) -> None:
        """Count the tokens of one attempt."""
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
        self._forget(now)

    def _forget(self, now: float) -> None:
        while self._recent and self._recent[0][0] < now - _WINDOW:
            self._recent.popleft()

    def _expect(self, request: Request) -> Reserved:
        usage = self.of(request.stage)
        if paid := self._paid[request.stage]:
            return Reserved(usage.tokens / paid, usage.cost / paid)
        prompt = estimate(request)
        return Reserved(prompt, self._price(request.model, prompt, 0))

    def _price(self, model: str, prompt_tokens: int, completion_tokens: int) -> float:
        price = self.prices.get(model, Price())
        return (prompt_tokens * price.prompt + completion_tokens * price.completion) / 1e6


def estimate(request: Request) -> int:
    """About how many tokens a prompt has."""
    return sum(len(message.content) for message in request.messages) // _CHARACTERS
