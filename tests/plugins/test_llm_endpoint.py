"""A model behind an endpoint that fails in every way: each is a counted outcome of one request, or a clear stop."""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from envcraft_llm.endpoint import ModelChoice, OpenedModel, accounts, faults, open_model
from envcraft_llm.endpoint.accounts import Accounts, BudgetSpent
from envcraft_llm.endpoint.pace import Pace
from envcraft_llm.endpoint.settings import Price
from envcraft_llm.model import Answer, Message, ModelFailure, ModelStopped, Request

from tests.plugins.loopback import Loopback, Reply, error, hang, piece, says, status, stream

KEY = "sk-loopback-0123456789"
DONE = "data: [DONE]"


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pauses between attempts are short, and there is a key."""
    monkeypatch.setattr(faults, "_LONGEST", 0.01)
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    for name in ("OPENAI_BASE_URL", "ENVCRAFT_LLM_KEY_ENV"):
        monkeypatch.delenv(name, raising=False)


def request(text: str = "write a game", **more: Any) -> Request:
    told: dict[str, Any] = {"model": "gpt-oss-120b", "stage": "code", "concept": "c1", **more}
    return Request(messages=(Message("user", text),), **told)


def choice(server: Loopback, **more: Any) -> ModelChoice:
    return msgspec.structs.replace(ModelChoice(base_url=server.url, retries=2), **more)


def played(
    server: Loopback,
    use: Callable[[OpenedModel], Awaitable[Any]],
    journal: Path | None = None,
    **more: Any,
) -> Any:
    """What `use` makes of a model at the server."""

    async def run() -> Any:
        async with server:
            model = open_model(choice(server, **more), journal)
            try:
                return await use(model)
            finally:
                await model.close()

    return asyncio.run(run())


def asked(server: Loopback, asking: Request | None = None, **more: Any) -> Answer:
    answer = played(server, lambda model: model.ask(asking or request()), **more)
    assert isinstance(answer, Answer)
    return answer


def test_an_answer_comes_with_usage_and_without_its_pieces() -> None:
    server = Loopback(says("class Frog:\n    pass\n"), models=["gpt-oss-120b"])

    async def use(model: OpenedModel) -> None:
        answer = await model.ask(request(effort="high", max_tokens=900, temperature=0.5))
        assert answer.text == "class Frog:\n    pass\n"
        assert (answer.prompt_tokens, answer.completion_tokens, answer.finish, answer.model) == (7, 3, "stop", "loop")
        assert answer.seconds > 0
        usage = model.accounts.by_stage["code"]
        assert (usage.asked, usage.replayed, usage.retries, usage.tokens) == (1, 0, 0, 10)
        assert usage.cost == pytest.approx((7 * 1.0 + 3 * 2.0) / 1e6)
        assert model.accounts.tokens_per_second > 0
        assert model.limit == 16

    played(server, use, prices={"gpt-oss-120b": Price(prompt=1.0, completion=2.0)})
    (body,) = server.asked
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
def test_thoughts_are_kept_out_of_the_text(events: list[str], text: str, reasoning: str) -> None:
    answer = asked(Loopback(stream(*events, piece("stop"), DONE)))
    assert (answer.text, answer.reasoning) == (text, reasoning)


def test_a_server_that_streams_nothing_and_one_that_tells_no_usage() -> None:
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
def test_what_passes_is_tried_again(first: Reply, more: dict[str, Any]) -> None:
    server = Loopback(first, GOOD)

    async def use(model: OpenedModel) -> None:
        assert (await model.ask(request())).text == "code"
        usage = model.accounts.of("code")
        assert (usage.asked, usage.retries, usage.failures.total()) == (2, 1, 0)

    played(server, use, **more)
    assert len(server.asked) == 2


@pytest.mark.parametrize(
    ("reply", "kind", "times", "words"),
    [
        (stream(piece("stop"), DONE), "empty", 1, "the answer is empty"),
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
        (stream("data: \x00\x01 no JSON"), "garbage", 3, "is no piece"),
        (stream(piece(content="co"), cut=True), "disconnected", 3, "the connection"),
        (stream(piece(content="co")), "disconnected", 3, "before the answer did"),
        (hang, "timeout", 3, "no beginning of an answer within 0.6 s"),
        (stream(*[piece(content="drip ")] * 600, pause=0.1), "timeout", 1, "no end of the answer within 2 s"),
        (error(500, "oh"), "server-error", 3, "HTTP 500"),
        (error(429, "slow", retry_after="0"), "server-error", 3, "HTTP 429"),
        (error(400, "the messages are wrong"), "server-error", 1, "messages are wrong"),
    ],
)
def test_what_does_not_pass_is_the_end_of_one_request(reply: Reply, kind: str, times: int, words: str) -> None:
    server = Loopback(reply)

    async def use(model: OpenedModel) -> None:
        with pytest.raises(ModelFailure, match=words) as failed:
            await model.ask(request())
        assert failed.value.kind == kind
        usage = model.accounts.of("code")
        assert usage.failures == {kind: 1}
        assert (usage.asked, usage.retries) == (times, times - 1)
        # Other requests go on.
        server._replies[:] = [GOOD]
        assert (await model.ask(request("another"))).text == "code"

    short: dict[str, Any] = (
        {"first_seconds": 0.6} if reply is hang else {"total_seconds": 2.0} if "no end" in words else {}
    )
    played(server, use, **short)
    assert len(server.asked) == times + 1


def test_a_short_answer_that_is_no_refusal_is_an_answer() -> None:
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
        (error(401, f"Incorrect API key provided: {KEY}"), r"refuses the key \(HTTP 401.*in OPENAI_API_KEY"),
        (error(403, "not for you"), "refuses the key"),
        (error(402, "pay first"), "nothing left"),
        (error(429, "You exceeded your current quota", "insufficient_quota"), "nothing left"),
    ],
)
def test_what_no_request_can_mend_stops_the_run_and_says_what_to_do(reply: Reply, words: str) -> None:
    server = Loopback(reply, models=["qwen", "llama"])

    async def use(model: OpenedModel) -> None:
        for text in ("one", "two"):
            with pytest.raises(ModelStopped, match=words) as stopped:
                await model.ask(request(text))
            assert server.url in str(stopped.value)
            assert KEY not in "".join(traceback.format_exception(stopped.value))

    played(server, use)
    assert len(server.asked) == 1


def test_a_bad_key_is_told_by_the_first_question_and_the_key_is_nowhere(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("ENVCRAFT_LLM_KEY_ENV", "LAB_KEY")
    monkeypatch.setenv("LAB_KEY", "lab-secret")
    caplog.set_level("DEBUG")
    refusing = Loopback(GOOD, greeting=error(401, "lab-secret is no key"))
    with pytest.raises(ModelStopped, match=r"\[key\] is no key.*the one in LAB_KEY") as stopped:
        asked(refusing, journal=tmp_path / "journal.sqlite")
    assert not refusing.asked
    echoing = Loopback(error(400, "bad: Bearer lab-secret"))
    with pytest.raises(ModelFailure, match="Bearer \\[key\\]"):
        asked(echoing, journal=tmp_path / "journal.sqlite")
    monkeypatch.delenv("LAB_KEY")
    with pytest.raises(ModelStopped, match="none is set in LAB_KEY"):
        asked(Loopback(error(401, "who are you?")))
    told = "".join([*capfd.readouterr(), caplog.text, *traceback.format_exception(stopped.value)])
    assert "lab-secret" not in told
    assert not [path for path in tmp_path.iterdir() if b"lab-secret" in path.read_bytes()]


@pytest.mark.parametrize(("key", "left"), [(KEY, "[key]"), ("EMPTY", "EMPTY")])
def test_a_key_in_an_answer_is_taken_out_and_a_word_in_its_place_stays(
    monkeypatch: pytest.MonkeyPatch, key: str, left: str
) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", key)
    half = len(key) // 2
    told = [piece(reasoning=f"{key}?"), piece(content=key[:half]), piece(content=f"{key[half:]} = 0"), piece("stop")]
    answer = asked(Loopback(stream(*told)))
    assert (answer.text, answer.reasoning) == (f"{left} = 0", f"{left}?")


def test_an_endpoint_that_is_down_stops_at_once_and_one_that_went_down_after_retries() -> None:
    async def run() -> None:
        server = Loopback(GOOD)
        async with server:
            pass
        model = open_model(choice(server), None)
        with pytest.raises(ModelStopped, match=f"nothing answers at {server.url} .*: start the endpoint there"):
            await model.ask(request())
        await model.close()

        async with server:
            model = open_model(choice(server), None)
            assert await model.ask(request())
        with pytest.raises(ModelStopped, match=r"any more .*3 attempts.*what was answered is kept"):
            await model.ask(request("another"))
        with pytest.raises(ModelStopped):
            await model.ask(request("a third"))
        assert len(server.asked) == 1
        await model.close()

    asyncio.run(run())


def test_an_endpoint_that_comes_back_is_asked_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "_LONGEST", 0.2)

    async def run() -> None:
        server = Loopback(GOOD)
        async with server:
            model = open_model(choice(server, retries=20), None)
            assert await model.ask(request())
        asking = asyncio.create_task(model.ask(request("another")))
        await asyncio.sleep(0.3)
        assert not asking.done()
        async with server:
            assert (await asking).text == "code"
            await model.close()

    asyncio.run(run())


def test_an_endpoint_that_fails_every_request_stops_the_run() -> None:
    server = Loopback(error(400, "no grammar engine"))

    async def use(model: OpenedModel) -> None:
        for number in range(20):
            with pytest.raises(ModelFailure):
                await model.ask(request(str(number)))
        with pytest.raises(
            ModelStopped, match=r"failed 20 requests in a row, the last with: HTTP 400: .*no grammar engine"
        ):
            await model.ask(request("one more"))

    played(server, use)


SCHEMA = {"type": "object", "properties": {"viable": {"type": "boolean"}}, "required": ["viable"]}


def test_parameters_that_an_endpoint_refuses_are_told_in_words_or_left_out() -> None:
    async def picky(writer: asyncio.StreamWriter, body: dict[str, Any]) -> None:
        for name in ("response_format", "reasoning_effort", "stream_options", "temperature", "max_tokens"):
            if name in body:
                await error(400, f"{name} is not supported")(writer, body)
                return
        await says('{"viable": true}')(writer, body)

    server = Loopback(picky)

    async def use(model: OpenedModel) -> None:
        for text in ("one", "two"):
            told = request(text, schema=SCHEMA, effort="low", temperature=0.1, max_tokens=50)
            assert (await model.ask(told)).text == '{"viable": true}'
        assert model.accounts.of("code").failures.total() == 0

    played(server, use)
    first, last = server.asked[0], server.asked[-1]
    assert first["response_format"]["json_schema"]["schema"] == SCHEMA
    # What was refused once is not tried with the next request.
    assert len(server.asked) == 7
    assert [message["role"] for message in last["messages"]] == ["system", "user"]
    assert last["messages"][0]["content"] == "Reasoning: low"
    assert '"viable"' in last["messages"][1]["content"]
    assert last["max_completion_tokens"] == 50


def test_rate_limits_lower_the_pace_and_answers_raise_it() -> None:
    async def limited(writer: asyncio.StreamWriter, body: dict[str, Any]) -> None:
        if server.under_way > 4:
            await error(429, "too many", retry_after="0.02")(writer, body)
        else:
            await says("code", pause=0.001)(writer, body)

    server = Loopback(limited)
    limits: list[int] = []

    async def use(model: OpenedModel) -> None:
        async def one(number: int) -> None:
            assert (await model.ask(request(str(number)))).text == "code"
            limits.append(model.limit)

        await asyncio.gather(*(one(number) for number in range(120)))

    played(server, use, retries=50)
    assert server.most <= 16
    assert min(limits) <= 4
    assert max(limits[60:]) <= 12


def test_the_pace_rises_to_the_most_where_nothing_holds_it() -> None:
    server = Loopback(says("code", pause=0.002))

    async def use(model: OpenedModel) -> int:
        await asyncio.gather(*(model.ask(request(str(number))) for number in range(150)))
        return model.limit

    assert played(server, use, max_concurrency=40) == 40
    assert 16 < server.most <= 40


def test_retry_after_is_waited_for_by_all() -> None:
    server = Loopback(error(429, "slow", retry_after="0.4"), GOOD)

    async def use(model: OpenedModel) -> None:
        first = asyncio.create_task(model.ask(request("one")))
        while not model.accounts.of("code").retries:
            await asyncio.sleep(0.01)
        await asyncio.gather(first, model.ask(request("two")))

    played(server, use)
    before, *after = server.times
    assert min(after) - before >= 0.4


def test_who_waits_for_the_endpoint_ends_with_the_run() -> None:
    server = Loopback(error(429, "slow", retry_after="60"))

    async def use(model: OpenedModel) -> None:
        asking = [asyncio.create_task(model.ask(request(str(number)))) for number in range(4)]
        while not model.accounts.of("code").retries:
            await asyncio.sleep(0.01)
        asking.append(asyncio.create_task(model.ask(request("one that was not sent"))))
        await asyncio.sleep(0.05)
        await asyncio.wait_for(model.close(), 60)
        for task in asking:
            with pytest.raises(ModelStopped, match="the run has ended"):
                await task

    async def run() -> None:
        async with server:
            await use(open_model(choice(server), None))

    asyncio.run(run())
    assert len(server.asked) <= 4


def test_a_place_whose_waiter_was_cancelled_goes_to_the_next() -> None:
    async def run() -> None:
        pace = Pace(1, 1)
        await pace.enter()
        cancelled, next_one = (asyncio.create_task(pace.enter()) for _ in range(2))
        await asyncio.sleep(0)
        cancelled.cancel()
        # Before the cancelled one has come to hear of it.
        pace.leave()
        with pytest.raises(asyncio.CancelledError):
            await cancelled
        await asyncio.wait_for(next_one, 60)
        assert pace.under_way == 1

    asyncio.run(run())


def test_a_limit_that_only_what_is_under_way_fills_says_so() -> None:
    prices = {"gpt-oss-120b": Price(prompt=1000.0)}
    for limits, words in (
        ({"max_tokens_total": 100}, "^0 tokens are used, about 75 are under way, .* the limit of 100;"),
        ({"max_cost": 0.1}, r"^0 are spent, about 0\.075 are under way, .* the limit of 0\.1;"),
    ):
        books = Accounts(ModelChoice(prices=prices, **limits))
        books.reserve(request("a" * 300))
        with pytest.raises(BudgetSpent, match=words):
            books.reserve(request("b" * 300))


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"max_tokens_total": 100}, "tokens are used"),
        ({"max_cost": 1e-4}, "are spent"),
        ({"max_seconds": 10}, "the time limit of 10 s"),
    ],
)
def test_a_budget_ends_the_run_and_loses_no_answer(
    limits: dict[str, Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = Loopback(says("a b c", pause=0.02))
    # Each request takes a second.
    monkeypatch.setattr(accounts, "time", SimpleNamespace(monotonic=lambda: float(len(server.asked))))
    prices = {name: Price(prompt=1.0, completion=1.0) for name in ("gpt-oss-120b", "gpt-oss-20b")}
    got: list[Answer] = []

    async def use(model: OpenedModel) -> None:
        async def one(number: int) -> None:
            got.append(await model.ask(request(str(number))))

        async def all_of_them() -> None:
            async with asyncio.TaskGroup() as group:
                for number in range(200):
                    group.create_task(one(number))

        with pytest.raises(ExceptionGroup) as stopped:
            await all_of_them()
        first = stopped.value.exceptions[0]
        assert isinstance(first, BudgetSpent)
        assert words in str(first)

    played(server, use, journal=tmp_path / "journal.sqlite", max_concurrency=4, prices=prices, **limits)
    paid = len(server.asked)
    # A request uses 10 tokens; what the first four would use was not known.
    assert len(got) <= paid <= 14
    assert paid >= 5

    # Those that were under way when the others were cancelled are in the journal, too.
    async def again(model: OpenedModel) -> None:
        for body in server.asked[:paid]:
            assert await model.ask(request(body["messages"][0]["content"]))
        assert model.accounts.of("code").replayed == paid

    played(server, again, journal=tmp_path / "journal.sqlite")
    assert len(server.asked) == paid
