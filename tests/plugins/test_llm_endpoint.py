"""An endpoint that fails in every way: each failure fails one request or stops the run with a message."""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from envcraft_llm.endpoint import JournaledModel, ModelSettings, errors, open_model, usage
from envcraft_llm.endpoint.concurrency import ConcurrencyLimiter
from envcraft_llm.endpoint.settings import Price
from envcraft_llm.endpoint.usage import BudgetExceeded, UsageTracker
from envcraft_llm.model import Completion, Message, ModelUnavailable, Request, RequestFailed

from tests.plugins.loopback import Loopback, Reply, error, hang, piece, says, status, stream

KEY = "sk-loopback-0123456789"
DONE = "data: [DONE]"


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the backoff, and set a key."""
    monkeypatch.setattr(errors, "_MAX_BACKOFF", 0.01)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    for name in ("OPENAI_BASE_URL", "ENVCRAFT_LLM_KEY_ENV"):
        monkeypatch.delenv(name, raising=False)


def request(text: str = "write a game", **more: Any) -> Request:
    told: dict[str, Any] = {"model": "gpt-oss-120b", "stage": "code", "concept": "c1", **more}
    return Request(messages=(Message("user", text),), **told)


def choice(server: Loopback, **more: Any) -> ModelSettings:
    return msgspec.structs.replace(ModelSettings(base_url=server.url, retries=2), **more)


def played(
    server: Loopback,
    use: Callable[[JournaledModel], Awaitable[Any]],
    journal: Path | None = None,
    **more: Any,
) -> Any:
    """Return the result of `use` on a model of the server."""

    async def run() -> Any:
        async with server:
            model = open_model(choice(server, **more), journal)
            try:
                return await use(model)
            finally:
                await model.close()

    return asyncio.run(run())


def asked(server: Loopback, asking: Request | None = None, **more: Any) -> Completion:
    answer = played(server, lambda model: model.generate(asking or request()), **more)
    assert isinstance(answer, Completion)
    return answer


def test_a_completion_has_text_and_usage() -> None:
    server = Loopback(says("class Frog:\n    pass\n"), models=["gpt-oss-120b"])

    async def use(model: JournaledModel) -> None:
        answer = await model.generate(request(effort="high", max_tokens=900, temperature=0.5))
        assert answer.text == "class Frog:\n    pass\n"
        assert (answer.prompt_tokens, answer.completion_tokens, answer.finish, answer.model) == (7, 3, "stop", "loop")
        assert answer.seconds > 0
        usage = model.usage.by_stage["code"]
        assert (usage.attempts, usage.replayed, usage.retries, usage.tokens) == (1, 0, 0, 10)
        assert usage.cost == pytest.approx((7 * 1.0 + 3 * 2.0) / 1e6)
        assert model.usage.tokens_per_second > 0
        assert model.limit == 16

    played(server, use, prices={"gpt-oss-120b": Price(prompt=1.0, completion=2.0)})
    (body,) = server.requests
    assert body["messages"] == [{"role": "user", "content": "write a game"}]
    assert (body["reasoning_effort"], body["max_tokens"], body["temperature"]) == ("high", 900, 0.5)
    assert body["stream_options"] == {"include_usage": True}
    assert server.headers["authorization"] == f"Bearer {KEY}"


@pytest.mark.parametrize(
    ("events", "text", "reasoning"),
    [
        ([piece(reasoning_content="hm "), piece(reasoning="so"), piece(content="code")], "code", "hm so"),
        (
            [
                piece(content="<|channel|>analysis<|mess"),
                piece(content="age|>hm<|end|><|start|>assistant<|channel|>final<|message|>code"),
            ],
            "code",
            "hm",
        ),
        (
            [piece(content="hm<|end|><|start|>assistant<|channel|>final <|message|>co"), piece(content="de")],
            "code",
            "hm",
        ),
        ([piece(content='<|channel|>final <|constrain|>json<|message|>{"a": 1}<|return|>')], '{"a": 1}', ""),
        ([piece(content="<think>\nhm\n</think>\n\ncode")], "code", "hm"),
        ([piece(content="hm</think>code")], "code", "hm"),
        ([piece(content="analysisWe think. assistantfinalcode")], "code", "We think."),
        ([piece(content="if a <| b: pass  # analysis")], "if a <| b: pass  # analysis", ""),
        ([piece(content="analysis of the game: assistantfinal")], "analysis of the game: assistantfinal", ""),
    ],
)
def test_reasoning_is_separated_from_the_text(events: list[str], text: str, reasoning: str) -> None:
    answer = asked(Loopback(stream(*events, piece("stop"), DONE)))
    assert (answer.text, answer.reasoning) == (text, reasoning)


def test_servers_without_streaming_or_usage() -> None:
    whole = {"model": "m", "choices": [{"message": {"content": "code", "reasoning": "hm"}, "finish_reason": "length"}]}
    answer = asked(Loopback(status(200, {**whole, "usage": {"prompt_tokens": 3, "completion_tokens": 4}})))
    assert (answer.text, answer.reasoning, answer.finish, answer.completion_tokens) == ("code", "hm", "length", 4)
    untold = asked(Loopback(stream(piece(content="a "), piece(content="b"), piece("stop"))), request("x" * 40))
    assert (untold.text, untold.prompt_tokens, untold.completion_tokens) == ("a b", 10, 2)


GOOD = says("code")


@pytest.mark.parametrize(
    ("first", "more"),
    [
        (error(429, "slow down", retry_after="0"), {}),
        (error(429, "slow down", retry_after_ms="5"), {}),
        (error(429, "slow down", retry_after="Wed, 21 Oct 2015 07:28:00 GMT"), {}),
        (error(408, "late"), {}),
        (error(409, "locked"), {}),
        (error(500, "oh"), {}),
        (status(503, "<html>busy</html>"), {}),
        (stream(piece(content="co"), cut=True), {}),
        (stream(piece(content="co")), {}),
        (stream('data: {"error": {"message": "engine died", "code": 500}}'), {}),
        (stream('error: {"message": "slot lost", "code": 500}'), {}),
        (status(200, "<html>a login page</html>"), {}),
        (stream("data: {"), {}),
        (stream('data: {"choices": "all of them"}'), {}),
        (hang, {"first_seconds": 0.8}),
        (stream(piece(content="co"), stay=60), {"silence_seconds": 0.8}),
    ],
)
def test_retryable_errors_are_retried(first: Reply, more: dict[str, Any]) -> None:
    server = Loopback(first, GOOD)

    async def use(model: JournaledModel) -> None:
        assert (await model.generate(request())).text == "code"
        usage = model.usage.of("code")
        assert (usage.attempts, usage.retries, usage.failures.total()) == (2, 1, 0)

    played(server, use, **more)
    assert len(server.requests) == 2


@pytest.mark.parametrize(
    ("reply", "kind", "times", "words"),
    [
        (stream(piece("stop"), DONE), "empty", 1, "the completion is empty"),
        (stream(piece(reasoning="hm"), piece("length"), DONE), "empty", 1, "2 characters of reasoning, cut off"),
        (stream(piece(content="<think>never"), piece("length"), DONE), "empty", 1, "5 characters of reasoning"),
        (stream(piece(refusal="No."), piece("stop"), DONE), "refused", 1, "refused: No."),
        (says("I'm sorry, but I can't help with that."), "refused", 1, "can't help"),
        (stream(piece(content="a"), piece("content_filter"), DONE), "refused", 1, "filter"),
        (error(400, "flagged by our safety system", "content_policy_violation"), "refused", 1, "safety"),
        (error(400, "This model's maximum context length is 8192 tokens"), "context-overflow", 1, "8192"),
        (error(400, "'max_tokens' is too large: maximum context length is 1"), "context-overflow", 1, "too large"),
        (status(500, {"error": {"type": "exceed_context_size_error"}}), "context-overflow", 1, "exceed_context"),
        (stream('data: {"error": {"code": 400, "message": "context size exceeded"}}'), "context-overflow", 1, "size"),
        (status(200, "<html>a login page</html>"), "garbage", 3, "a login page"),
        (stream("data: \x00\x01 no JSON"), "garbage", 3, "is not a completion chunk"),
        (stream(piece(content="co"), cut=True), "disconnected", 3, "the connection"),
        (stream(piece(content="co")), "disconnected", 3, "before the completion ended"),
        (hang, "timeout", 3, "no first chunk within 0.6 s"),
        (stream(*[piece(content="drip ")] * 600, pause=0.1), "timeout", 1, "the completion did not end within 2 s"),
        (error(500, "oh"), "server-error", 3, "HTTP 500"),
        (error(429, "slow", retry_after="0"), "server-error", 3, "HTTP 429"),
        (error(400, "the messages are wrong"), "server-error", 1, "messages are wrong"),
    ],
)
def test_lasting_errors_fail_one_request(reply: Reply, kind: str, times: int, words: str) -> None:
    server = Loopback(reply)

    async def use(model: JournaledModel) -> None:
        with pytest.raises(RequestFailed, match=words) as failed:
            await model.generate(request())
        assert failed.value.kind == kind
        usage = model.usage.of("code")
        assert usage.failures == {kind: 1}
        assert (usage.attempts, usage.retries) == (times, times - 1)
        # Other requests go on.
        server._replies[:] = [GOOD]
        assert (await model.generate(request("another"))).text == "code"

    short: dict[str, Any] = (
        {"first_seconds": 0.6} if reply is hang else {"total_seconds": 2.0} if "did not end" in words else {}
    )
    played(server, use, **short)
    assert len(server.requests) == times + 1


def test_texts_that_only_resemble_a_refusal() -> None:
    assert asked(Loopback(says("Sorry-Frog is a game."))).text
    assert asked(Loopback(says("I cannot tell." + " It is long." * 60))).text


@pytest.mark.parametrize(
    ("reply", "words"),
    [
        (
            error(404, "The model `gpt-oss-120b` does not exist", "model_not_found"),
            "has no model 'gpt-oss-120b'.*it has qwen",
        ),
        (error(400, "unknown model gpt-oss-120b"), "has no model 'gpt-oss-120b'"),
        (status(404, "<html>no such page</html>"), "most addresses end in /v1"),
        (error(401, f"Incorrect API key provided: {KEY}"), r"rejects the key \(HTTP 401.*in OPENAI_API_KEY"),
        (error(403, "not for you"), "rejects the key"),
        (error(402, "pay first"), "no credit left"),
        (error(429, "You exceeded your current quota", "insufficient_quota"), "no credit left"),
    ],
)
def test_fatal_errors_stop_the_run_with_advice(reply: Reply, words: str) -> None:
    server = Loopback(reply, models=["qwen", "llama"])

    async def use(model: JournaledModel) -> None:
        for text in ("one", "two"):
            with pytest.raises(ModelUnavailable, match=words) as stopped:
                await model.generate(request(text))
            assert server.url in str(stopped.value)
            assert KEY not in "".join(traceback.format_exception(stopped.value))

    played(server, use)
    assert len(server.requests) == 1


def test_a_bad_key_is_detected_first_and_never_printed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("ENVCRAFT_LLM_KEY_ENV", "LAB_KEY")
    monkeypatch.setenv("LAB_KEY", "lab-secret")
    caplog.set_level("DEBUG")
    refusing = Loopback(GOOD, greeting=error(401, "lab-secret is no key"))
    with pytest.raises(ModelUnavailable, match=r"\[key\] is no key.*the one in LAB_KEY") as stopped:
        asked(refusing, journal=tmp_path / "journal.sqlite")
    assert not refusing.requests
    echoing = Loopback(error(400, "bad: Bearer lab-secret"))
    with pytest.raises(RequestFailed, match="Bearer \\[key\\]"):
        asked(echoing, journal=tmp_path / "journal.sqlite")
    monkeypatch.delenv("LAB_KEY")
    with pytest.raises(ModelUnavailable, match="none is set in LAB_KEY"):
        asked(Loopback(error(401, "who are you?")))
    told = "".join([*capfd.readouterr(), caplog.text, *traceback.format_exception(stopped.value)])
    assert "lab-secret" not in told
    assert not [path for path in tmp_path.iterdir() if b"lab-secret" in path.read_bytes()]


@pytest.mark.parametrize(("key", "left"), [(KEY, "[key]"), ("EMPTY", "EMPTY")])
def test_a_key_is_redacted_and_a_placeholder_is_not(monkeypatch: pytest.MonkeyPatch, key: str, left: str) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", key)
    half = len(key) // 2
    told = [piece(reasoning=f"{key}?"), piece(content=key[:half]), piece(content=f"{key[half:]} = 0"), piece("stop")]
    answer = asked(Loopback(stream(*told)))
    assert (answer.text, answer.reasoning) == (f"{left} = 0", f"{left}?")


def test_an_unreachable_endpoint_stops_the_run() -> None:
    async def run() -> None:
        server = Loopback(GOOD)
        async with server:
            pass
        model = open_model(choice(server), None)
        with pytest.raises(ModelUnavailable, match=f"nothing listens at {server.url} .*: start the endpoint"):
            await model.generate(request())
        await model.close()

        async with server:
            model = open_model(choice(server), None)
            assert await model.generate(request())
        with pytest.raises(ModelUnavailable, match=r"any more .*3 attempts.*all completions so far are stored"):
            await model.generate(request("another"))
        with pytest.raises(ModelUnavailable):
            await model.generate(request("a third"))
        assert len(server.requests) == 1
        await model.close()

    asyncio.run(run())


def test_requests_continue_once_the_endpoint_is_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(errors, "_MAX_BACKOFF", 0.2)

    async def run() -> None:
        server = Loopback(GOOD)
        async with server:
            model = open_model(choice(server, retries=20), None)
            assert await model.generate(request())
        asking = asyncio.create_task(model.generate(request("another")))
        await asyncio.sleep(0.3)
        assert not asking.done()
        async with server:
            assert (await asking).text == "code"
            await model.close()

    asyncio.run(run())


def test_an_endpoint_that_fails_every_request_stops_the_run() -> None:
    server = Loopback(error(400, "no grammar engine"))

    async def use(model: JournaledModel) -> None:
        for number in range(20):
            with pytest.raises(RequestFailed):
                await model.generate(request(str(number)))
        with pytest.raises(
            ModelUnavailable, match=r"failed 20 requests in a row, the last with: HTTP 400: .*no grammar engine"
        ):
            await model.generate(request("one more"))

    played(server, use)


SCHEMA = {"type": "object", "properties": {"viable": {"type": "boolean"}}, "required": ["viable"]}


def test_unsupported_parameters_are_left_out_or_moved_into_messages() -> None:
    async def picky(writer: asyncio.StreamWriter, body: dict[str, Any]) -> None:
        for name in ("response_format", "reasoning_effort", "stream_options", "temperature", "max_tokens"):
            if name in body:
                await error(400, f"{name} is not supported")(writer, body)
                return
        await says('{"viable": true}')(writer, body)

    server = Loopback(picky)

    async def use(model: JournaledModel) -> None:
        for text in ("one", "two"):
            told = request(text, schema=SCHEMA, effort="low", temperature=0.1, max_tokens=50)
            assert (await model.generate(told)).text == '{"viable": true}'
        assert model.usage.of("code").failures.total() == 0

    played(server, use)
    first, last = server.requests[0], server.requests[-1]
    assert first["response_format"]["json_schema"]["schema"] == SCHEMA
    # What was refused once is not tried with the next request.
    assert len(server.requests) == 7
    assert [message["role"] for message in last["messages"]] == ["system", "user"]
    assert last["messages"][0]["content"] == "Reasoning: low"
    assert '"viable"' in last["messages"][1]["content"]
    assert last["max_completion_tokens"] == 50


def test_rate_limits_lower_the_concurrency_limit() -> None:
    async def limited(writer: asyncio.StreamWriter, body: dict[str, Any]) -> None:
        if server.in_flight > 4:
            await error(429, "too many", retry_after="0.02")(writer, body)
        else:
            await says("code", pause=0.001)(writer, body)

    server = Loopback(limited)
    limits: list[int] = []

    async def use(model: JournaledModel) -> None:
        async def one(number: int) -> None:
            assert (await model.generate(request(str(number)))).text == "code"
            limits.append(model.limit)

        await asyncio.gather(*(one(number) for number in range(120)))

    played(server, use, retries=50)
    assert server.max_in_flight <= 16
    assert min(limits) <= 4
    assert max(limits[60:]) <= 12


def test_the_concurrency_limit_rises_to_its_maximum() -> None:
    server = Loopback(says("code", pause=0.002))

    async def use(model: JournaledModel) -> int:
        await asyncio.gather(*(model.generate(request(str(number))) for number in range(150)))
        return model.limit

    assert played(server, use, max_concurrency=40) == 40
    assert 16 < server.max_in_flight <= 40


def test_retry_after_applies_to_all_requests() -> None:
    server = Loopback(error(429, "slow", retry_after="0.4"), GOOD)

    async def use(model: JournaledModel) -> None:
        first = asyncio.create_task(model.generate(request("one")))
        while not model.usage.of("code").retries:
            await asyncio.sleep(0.01)
        await asyncio.gather(first, model.generate(request("two")))

    played(server, use)
    before, *after = server.times
    assert min(after) - before >= 0.4


def test_waiting_requests_end_with_the_run() -> None:
    server = Loopback(error(429, "slow", retry_after="60"))

    async def use(model: JournaledModel) -> None:
        asking = [asyncio.create_task(model.generate(request(str(number)))) for number in range(4)]
        while not model.usage.of("code").retries:
            await asyncio.sleep(0.01)
        asking.append(asyncio.create_task(model.generate(request("one that was not sent"))))
        await asyncio.sleep(0.05)
        await asyncio.wait_for(model.close(), 60)
        for task in asking:
            with pytest.raises(ModelUnavailable, match="the run has ended"):
                await task

    async def run() -> None:
        async with server:
            await use(open_model(choice(server), None))

    asyncio.run(run())
    assert len(server.requests) <= 4


def test_the_slot_of_a_cancelled_waiter_goes_to_the_next() -> None:
    async def run() -> None:
        limiter = ConcurrencyLimiter(1, 1)
        await limiter.acquire()
        cancelled, next_one = (asyncio.create_task(limiter.acquire()) for _ in range(2))
        await asyncio.sleep(0)
        cancelled.cancel()
        # Before the cancelled one has come to hear of it.
        limiter.release()
        with pytest.raises(asyncio.CancelledError):
            await cancelled
        await asyncio.wait_for(next_one, 60)
        assert limiter.in_flight == 1

    asyncio.run(run())


def test_reservations_count_towards_the_limits() -> None:
    prices = {"gpt-oss-120b": Price(prompt=1000.0)}
    for limits, words in (
        ({"max_tokens_total": 100}, "^0 tokens are used, about 75 are in flight, .* the limit of 100;"),
        ({"max_cost": 0.1}, r"^0 are spent, about 0\.075 are in flight, .* the limit of 0\.1;"),
    ):
        tracker = UsageTracker(ModelSettings(prices=prices, **limits))
        tracker.reserve(request("a" * 300))
        with pytest.raises(BudgetExceeded, match=words):
            tracker.reserve(request("b" * 300))


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"max_tokens_total": 100}, "tokens are used"),
        ({"max_cost": 1e-4}, "are spent"),
        ({"max_seconds": 10}, "the time limit of 10 s"),
    ],
)
def test_an_exceeded_budget_ends_the_run_without_losses(
    limits: dict[str, Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = Loopback(says("a b c", pause=0.02))
    # Each request takes a second.
    monkeypatch.setattr(usage, "time", SimpleNamespace(monotonic=lambda: float(len(server.requests))))
    prices = {name: Price(prompt=1.0, completion=1.0) for name in ("gpt-oss-120b", "gpt-oss-20b")}
    got: list[Completion] = []

    async def use(model: JournaledModel) -> None:
        async def one(number: int) -> None:
            got.append(await model.generate(request(str(number))))

        async def all_of_them() -> None:
            async with asyncio.TaskGroup() as group:
                for number in range(200):
                    group.create_task(one(number))

        with pytest.raises(ExceptionGroup) as stopped:
            await all_of_them()
        first = stopped.value.exceptions[0]
        assert isinstance(first, BudgetExceeded)
        assert words in str(first)

    played(server, use, journal=tmp_path / "journal.sqlite", max_concurrency=4, prices=prices, **limits)
    paid = len(server.requests)
    # A request uses 10 tokens; what the first four would use was not known.
    assert len(got) <= paid <= 14
    assert paid >= 5

    # Those that were under way when the others were cancelled are in the journal, too.
    async def again(model: JournaledModel) -> None:
        for body in server.requests[:paid]:
            assert await model.generate(request(body["messages"][0]["content"]))
        assert model.usage.of("code").replayed == paid

    played(server, again, journal=tmp_path / "journal.sqlite")
    assert len(server.requests) == paid
