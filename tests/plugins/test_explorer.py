"""``envcraft explore``: who may use the server, its limits, and the pages in a real browser."""

from __future__ import annotations

import http.client
import itertools
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner
from envcraft_explorer import export, recording
from envcraft_explorer.live import Limits
from envcraft_explorer.stage import Stage
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from envcraft.cli.group import cli
from envcraft.corpus.report.data import entries
from envcraft.corpus.store import Store
from envcraft.demonstrations.player import PolicyPlayer
from envcraft.judging.selection import driver_named
from envcraft.model.target import PolicyFile
from envcraft.text import one_line
from evaluation.explorer import Served, served
from tests.pages import chromium, window

from .explored import HOSTILE, POLICY, fill

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

Open = Callable[..., "Page"]
NAME = f"{HOSTILE}.py".replace("/", "_")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("explored") / "corpus"
    fill(root)
    return root


@pytest.fixture(scope="module")
def server(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("pages") / "site"
    with closing(driver_named("process")) as driver, served(corpus, folder, driver, most=2) as running:
        yield running


# Who may use the server


def asked(server: Served, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    found = answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    connection.close()
    return found


def cookie(server: Served) -> str:
    status, headers, _ = asked(server, f"/?token={server.token}")
    assert status == 303
    assert headers["location"] == "/"
    words = headers["set-cookie"]
    assert {"httponly", "samesite=strict"} <= {part.strip().lower() for part in words.split(";")}
    return words.partition(";")[0]


def test_only_the_printed_address_is_answered(server: Served) -> None:
    known = cookie(server)
    assert asked(server, "/", Cookie=known)[0] == 200
    refused: list[dict[str, str]] = [
        {},
        {"Cookie": known[:-1]},
        {"Cookie": known, "Host": "evil.example"},
        {"Cookie": known, "Host": f"evil.example:{server.port}"},
        {"Cookie": known, "Origin": "http://evil.example"},
        {"Cookie": known, "Origin": "null"},
        {"Cookie": known, "Origin": f"http://127.0.0.1:{server.port + 1}"},
    ]
    for headers in refused:
        for path in (
            "/",
            "/environments.html",
            "/live/players?environment=calm.py&number=1",
            "/live/finding?environment=crash.py&number=2&finding=1",
            "/data/rows-0.js",
        ):
            assert asked(server, path, **headers)[0] == 403, headers
    assert asked(server, "/?token=guess")[0] == 403


def test_every_answer_has_the_security_headers(server: Served) -> None:
    known = cookie(server)
    for path, status in (("/", 200), ("/assets/environments.js", 200), ("/nothing", 404), ("/../../etc/passwd", 404)):
        found, headers, _ = asked(server, path, Cookie=known)
        assert found == status, path
        policy = headers["content-security-policy"]
        assert "unsafe" not in policy
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert headers["x-content-type-options"] == "nosniff"


def socket_to(server: Served, origin: str | None = None, known: str | None = None) -> Any:
    headers = {"Cookie": cookie(server) if known is None else known}
    return connect(
        f"ws://127.0.0.1:{server.port}/live/play", additional_headers=headers, origin=Origin(origin or server.address)
    )


@pytest.mark.parametrize(("origin", "known"), [("http://evil.example", None), (None, "a=b")])
def test_no_other_page_plays(server: Served, origin: str | None, known: str | None) -> None:
    with pytest.raises(InvalidStatus, match="403"), socket_to(server, origin, known):
        pass


def start(opened: Any, **more: Any) -> dict[str, Any]:
    """Ask for an environment, and return the answer."""
    opened.send(json.dumps({"do": "start", "environment": "calm.py", "number": 1, "on": True, **more}))
    answer: dict[str, Any] = json.loads(opened.recv())
    return answer


def test_players_are_bounded_and_places_are_given_back(server: Served) -> None:
    with socket_to(server) as one, socket_to(server) as other:
        told = start(one)
        # The rate is that of the environment's metadata.
        assert (told["kind"], told["rate"]) == ("ready", 30)
        assert start(other)["kind"] == "ready"
        with socket_to(server) as refused:
            told = start(refused)
            assert told["kind"] == "refused"
            assert told["words"].startswith("2 environments are being played")
            with pytest.raises(ConnectionClosed):
                refused.recv()
    # The worker ends first, and then its place is free.
    kind = ""
    while kind != "ready":
        with socket_to(server) as again:
            kind = start(again)["kind"]


def answers(opened: Any) -> Iterator[dict[str, Any]]:
    """The messages until the end of the connection: those in JSON, and the JSON of frames."""
    with suppress(ConnectionClosed):
        while True:
            data = opened.recv()
            if isinstance(data, bytes):
                length = int.from_bytes(data[:4], "big")
                yield {"kind": "frame", "pixels": data[4 + length :], **json.loads(data[4 : 4 + length])}
            else:
                yield json.loads(data)


@pytest.mark.parametrize(
    ("limits", "more"),
    [
        (Limits(idle=0.1), {}),
        # No key is pressed in a running game.
        (Limits(idle=0.1), {"on": False}),
        (Limits(longest=1.0), {"on": False}),
        (Limits(longest=1.0), {"on": False, "player": "noop"}),
    ],
)
def test_a_session_ends_at_its_limits(corpus: Path, tmp_path: Path, limits: Limits, more: dict[str, Any]) -> None:
    with (
        closing(driver_named("process")) as driver,
        served(corpus, tmp_path / "site", driver, most=1, previews=False, limits=limits) as server,
    ):
        for _ in range(2):
            # The second one needs the place of the first.
            told = {"kind": "refused"}
            while told["kind"] == "refused" and "being played" in told.get("words", "being played"):
                with socket_to(server) as opened:
                    told = start(opened, **more)
                    last = [told, *answers(opened)][-1]
            assert last["kind"] in ("ended", "refused"), last
            assert last["words"].startswith("The session is over") or "longer than a session" in last["words"]


def test_sessions_last_ten_minutes_without_a_key_and_one_hour() -> None:
    assert Limits() == Limits(idle=600.0, longest=3_600.0)


def test_a_player_is_shown_step_by_step_and_again(server: Served) -> None:
    with socket_to(server) as opened:
        assert start(opened, player="policy 0", seed=3, on=False)["kind"] == "ready"
        opened.send(json.dumps({"do": "rate", "rate": 60}))
        shown, started = [], 0
        for message in answers(opened):
            if message["kind"] == "started":
                started += 1
                continue
            shown.append(message)
            if len(shown) == 20:
                opened.send(json.dumps({"do": "pause", "on": True}))
                opened.send(json.dumps({"do": "start", "on": True}))
                opened.send(json.dumps({"do": "step"}))
                opened.send(json.dumps({"do": "save"}))
            if len(shown) > 20 and json.loads(message["info"] or "{}").get("x", 0) == 1:
                break
    positions = [json.loads(message["info"] or '{"x": 0}').get("x", 0) for message in shown]
    # The policy walks to the right, one pixel a step; then the episode starts again.
    assert positions[:20] == list(range(20))
    assert positions[-2:] == [0, 1]
    assert shown[0]["pixels"] != shown[1]["pixels"]
    assert all(message["kind"] == "frame" for message in shown)
    assert started == 2


def test_keys_after_the_end_are_not_of_the_next_episode(server: Served) -> None:
    with socket_to(server) as opened:
        assert start(opened, environment="crash.py", number=2, on=False)["kind"] == "ready"
        opened.send(json.dumps({"do": "press", "key": "right", "held": ["right"]}))
        told = answers(opened)
        assert any(message["kind"] == "over" for message in told)
        for message in ({"do": "release"}, {"do": "press", "key": "right"}, {"do": "start"}):
            opened.send(json.dumps(message))
        shown = [message for message in itertools.islice(told, 6) if message["kind"] == "frame"]
    assert [json.loads(message["info"])["x"] for message in shown[1:]] == [0] * len(shown[1:])
    assert len(shown) >= 4


def test_unknown_players_are_refused(server: Served) -> None:
    with socket_to(server) as opened:
        told = start(opened, player="<b>nobody")
        assert (told["kind"], told["words"]) == ("refused", "there is no player <b>nobody")


def test_messages_out_of_turn_end_the_session_with_words(server: Served) -> None:
    for text in ("[]", "{", json.dumps({"environment": "nothing.py", "number": 7})):
        with socket_to(server) as opened:
            opened.send(text)
            assert json.loads(opened.recv())["kind"] == "refused"


# In a real browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def show(browser: Browser, server: Served) -> Iterator[Open]:
    """Open a page of the server; it may not log, raise or load anything from elsewhere."""
    complaints: list[str] = []
    contexts: list[BrowserContext] = []

    def show(name: str = "environments.html", **options: Any) -> Page:
        context = window(browser, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: watched(request.url))
        page.goto(server.entry)
        page.goto(f"{server.address}/{name}")
        return page

    def watched(url: str) -> None:
        if not url.startswith((server.address, "data:")):
            complaints.append(url)

    yield show
    for context in contexts:
        context.close()
    assert not complaints, complaints


@pytest.mark.browser
def test_a_person_searches_opens_and_plays(show: Open, tmp_path: Path) -> None:
    from playwright.sync_api import expect

    page = show()
    expect(page.locator("#rows li")).to_have_count(3)
    page.keyboard.press("/")
    page.keyboard.type("zeppel")
    expect(page.locator("#shown")).to_have_text("1 of 3")
    page.locator("#rows a").first.press("Enter")
    expect(page.locator("#one h1")).to_have_text("calm.py")
    controls, screen = page.locator("#part-play .controls"), page.locator("#part-play .large")
    # Paused, each key is one step.
    controls.get_by_role("button", name="Pause").click()
    controls.get_by_role("button", name="Play").click()
    expect(screen).to_have_attribute("data-frames", "1")
    first = screen.screenshot()
    for number in range(100):
        page.keyboard.press("ArrowRight")
        expect(screen).to_have_attribute("data-frames", str(number + 2))
    expect(page.locator("#part-play .said")).to_have_text("step 100 of 100, reward 0, return 1")
    assert screen.screenshot() != first
    assert '"x": 16' in page.locator("#part-play .flags").inner_text()
    slider = page.locator("#part-play .scrub")
    slider.press("Home")
    expect(page.locator("#part-play .said")).to_have_text(re.compile("^step 0 of"))
    with page.expect_download() as saving:
        controls.get_by_role("button", name="Save").click()
    saved = tmp_path / "episode.json"
    saving.value.save_as(saved)
    result = CliRunner().invoke(cli, ["replay", str(saved), "--sandbox", "process"])
    assert result.exit_code == 0, result.output
    assert "reproduced: a person played seed 0" in result.output


@pytest.mark.browser
def test_a_finding_is_replayed_and_players_play_side_by_side(show: Open) -> None:
    from playwright.sync_api import expect

    page = show("environments.html#environment=crash.py")
    found = page.locator(".finding").first
    expect(found).to_contain_text("EC107")
    found.get_by_role("button", name="Replay").click()
    expect(found.locator(".screen")).to_have_attribute("data-ready", "1")
    expect(found.locator(".lane .small").last).to_contain_text("reproduced: seed")
    page.goto(page.url.replace("crash.py", "calm.py"))
    players = page.locator("#part-watch .players")
    expect(players).to_have_attribute("data-ready", "1")
    for name in ("noop", "policy 0"):
        players.get_by_role("button", name=name, exact=True).click()
    lanes = page.locator("#part-watch .lane")
    expect(lanes.locator("h3")).to_have_text(["noop", "policy 0"])
    # Both play at the same time, in front of the person.
    for number in range(2):
        expect(lanes.nth(number).locator(".large")).to_have_attribute("data-frames", re.compile(r"^\d{2,}$"))
    page.get_by_role("button", name="Pause all").click()
    expect(lanes.locator(".state")).to_have_text(["Paused", "Paused"])
    policy = lanes.nth(1)
    policy.locator(".scrub").press("Home")
    expect(policy.locator(".said")).to_have_text(re.compile("^step 0 of"))
    # There are two places.
    players.get_by_role("button", name="random", exact=True).click()
    expect(lanes.nth(2).locator(".state")).to_have_text(re.compile("^2 environments are being played"))
    policy.get_by_role("button", name="Close policy 0").click()
    expect(lanes.locator("h3")).to_have_text(["noop", "random"])


@pytest.mark.browser
def test_another_episode_shows_no_frame_of_the_last_one(show: Open) -> None:
    from playwright.sync_api import expect

    page = show("environments.html#environment=calm.py")
    controls, screen = page.locator("#part-play .controls"), page.locator("#part-play .large")
    save = controls.get_by_role("button", name="Save")
    expect(save).to_be_disabled()
    controls.get_by_role("button", name="Play").click()
    controls.get_by_label("Speed").select_option("60")
    for _ in range(3):
        expect(screen).to_have_attribute("data-frames", re.compile(r"^\d{2,}$"))
        screen.press("r")
        expect(page.locator("#part-play .state")).to_have_text("Playing")
    controls.get_by_role("button", name="Pause").click()
    expect(page.locator("#part-play .state")).to_have_text("Paused: each key takes a step")
    with page.expect_download() as saving:
        save.click()
    (finding,) = json.loads(saving.value.path().read_text())["reports"][0]["checks"][0]["findings"]
    steps = len(finding["repro"]["actions"])
    expect(page.locator("#part-play .said")).to_have_text(re.compile(f"^step {steps} of {steps},"))
    # The episode is over: it has no next step, and can be saved again.
    expect(controls.get_by_role("button", name="Step")).to_be_disabled()
    expect(save).to_be_enabled()


@pytest.mark.browser
def test_a_player_that_plans_says_so(show: Open) -> None:
    from playwright.sync_api import expect

    page = show("environments.html#environment=calm.py")
    # It plans until the server answers.
    page.route_web_socket("**/live/play", lambda socket: None)
    page.locator("#part-watch .players").get_by_role("button", name="search").click()
    expect(page.get_by_role("progressbar", name="search plans its episode")).to_be_visible()
    expect(page.locator("#part-watch .lane .state")).to_contain_text("plans its whole episode")
    page.unroute_all()


@pytest.mark.browser
def test_the_copied_lines_open_an_environment_from_anywhere(show: Open, tmp_path: Path) -> None:
    page = show("environments.html#environment=crash.py", permissions=["clipboard-read", "clipboard-write"])
    page.locator("#part-use").get_by_role("button", name="Copy").click()
    page.locator("#part-use").get_by_role("button", name="Copied").wait_for()
    lines = page.evaluate("() => navigator.clipboard.readText()")
    command = [sys.executable, "-c", f"{lines}\nprint(observation.shape)"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert ran.stdout.split("\n")[-2:] == ["(84, 84, 3)", ""], ran.stderr


@pytest.mark.browser
def test_a_phone_shows_the_game_first_with_its_buttons(show: Open) -> None:
    from playwright.sync_api import expect

    size = {"width": 390, "height": 664}
    page = show("environments.html#environment=calm.py", viewport=size, is_mobile=True, has_touch=True)
    play = page.locator("#part-play").get_by_role("button", name="Play", exact=True)
    expect(play).to_be_in_viewport(ratio=1)
    play.tap()
    right = page.locator("#part-play .key-right")
    for one in (page.locator("#part-play .large"), right, page.locator("#part-play .key-z")):
        expect(one).to_be_in_viewport(ratio=1)
    # As long as the finger is down.
    right.dispatch_event("pointerdown")
    expect(page.locator("#part-play .flags")).to_contain_text(re.compile(r'"x": \d{2}'))
    right.dispatch_event("pointerup")
    page.locator("#part-play").get_by_role("button", name="Pause").tap()
    expect(page.locator("#part-play .state")).to_have_text("Paused: each key takes a step")
    frames = int(page.locator("#part-play .large").get_attribute("data-frames") or 0)
    right.tap()
    expect(page.locator("#part-play .large")).to_have_attribute("data-frames", str(frames + 1))


@pytest.mark.browser
def test_text_of_an_environment_stays_text(show: Open) -> None:
    from playwright.sync_api import expect

    page = show()
    page.locator("#rows a", has_text="<img").click()
    expect(page.locator("#one h1")).to_have_text(one_line(NAME))
    page.locator("#part-play .controls").get_by_role("button", name="Play").click()
    expect(page.locator("#part-play .flags")).to_contain_text("<script>")
    page.locator(".finding").first.get_by_role("button", name="Replay").click()
    expect(page.locator(".finding .screen").first).to_have_attribute("data-ready", "1")
    for summary in page.locator("#one summary").all():
        summary.click()
    expect(page.locator("#part-attempts .diff")).to_contain_text(HOSTILE)
    assert page.title() == one_line(NAME)
    assert page.locator("#one script, #one img:not(.film)").count() == 0
    page.goto(page.url.partition("environments.html")[0])
    assert page.title() != "owned"


@pytest.mark.browser
def test_the_export_plays_recorded_episodes_as_files(browser: Browser, corpus: Path, tmp_path: Path) -> None:
    from playwright.sync_api import expect

    site = tmp_path / "site"
    options = ["--export", str(site), "--sandbox", "process"]
    for player, returns in (("random", (1.0, 2.0)), ("checkpoint:run", (3.0, 1.0))):
        played = [
            {"name": name, "episodes": 5, "length": {"mean": 400.0}, "return": {"mean": mean}}
            for name, mean in zip(("calm.py", "crash.py"), returns, strict=True)
        ]
        (tmp_path / f"{player[0]}.json").write_text(json.dumps({"format": 1, "player": player, "environments": played}))
        options += ["--results", str(tmp_path / f"{player[0]}.json")]
    result = CliRunner().invoke(cli, ["explore", str(corpus), *options])
    assert result.exit_code == 0, result.output
    assert str(site / "index.html") in result.stdout
    complaints: list[str] = []
    page = window(browser).new_page()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"{site.as_uri()}/environments.html#environment=crash.py")
    # Nothing here can run code.
    assert page.locator("#part-play").count() == 0
    found = page.locator(".finding .screen").first
    expect(found).to_have_attribute("data-ready", "1")
    watched = page.locator("#part-watch .lane")
    expect(watched.locator(".screen[data-ready]")).to_have_count(2)
    screen = watched.first.locator(".large")
    before = screen.screenshot()
    watched.first.locator(".scrub").press("End")
    expect(watched.first.locator(".said")).not_to_have_text(re.compile("^step 0"))
    assert screen.screenshot() != before
    page.get_by_role("button", name="Play all").click()
    for number in range(2):
        expect(watched.nth(number).locator(".said")).not_to_have_text(re.compile("^step 0"))
    page.goto(f"{site.as_uri()}/environments.html#environment=calm.py")
    expect(page.locator("#part-watch .lane h3")).to_have_text(["random", "noop", "policy 0"])
    expect(page.locator("#part-watch")).to_contain_text("Not recorded: search, it takes too long")
    # In the order in which they run.
    expect(page.locator("#part-concept .checks li span + span")).to_have_text(["viability", "", "code", ""])
    page.goto(f"{site.as_uri()}/index.html")
    rows = [" ".join(row.split()) for row in page.locator("#training tbody tr").all_inner_texts()]
    assert rows == ["random 2 10 1.5 400", "checkpoint:run 2 10 2 400 1 of 2"]
    assert page.locator("#map a").count() == 0
    stages = [" ".join(row.split()[:6]) for row in page.locator("#generation tbody tr").all_inner_texts()]
    assert stages == ["viability 2 0 0 2 100.0%", "code 2 0 0 2 100.0%"]
    pools = {row.split()[0]: row.split()[1:6] for row in page.locator("#pools tbody tr").all_inner_texts()}
    # What a pool does not have counts nowhere.
    assert pools["genre"] == ["42", "0", "0", "0", "0.0%"]
    assert pools["mechanic"] == ["56", "1", "1", "1", "1.8%"]
    assert not complaints, complaints


def test_the_export_says_which_episodes_are_short_and_which_are_missing(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export, "_FINDINGS", 0)
    monkeypatch.setattr(recording, "FRAMES", 4)
    with closing(driver_named("process")) as driver:
        stage = Stage(corpus, "", driver, "arcade")
        put = export.record_all(stage, tmp_path, print)
    with Store(corpus) as store:
        told = {episode["label"]: episode for episode in put(list(entries(store))[2], tmp_path / "site")}
    assert told["noop"]["frames"] == 4
    assert told["noop"]["words"] == "seed 0, 1,000 steps, truncated; the first 4 frames"
    assert told["search"]["omitted"] == "it takes too long for all environments"
    assert told["EC107"]["omitted"] == "only those of the first 0 findings are"


def test_an_environment_of_a_folder_is_played_with_its_project(tmp_path: Path) -> None:
    source = b"import gymnasium\nfrom sizes import SIZE\n\n\nclass Walk(gymnasium.Env):\n    size = SIZE\n"
    (tmp_path / "walk.py").write_bytes(source)
    (tmp_path / "sizes.py").write_text("SIZE = 8\n")
    root = tmp_path / ".envcraft"
    with Store.create(root, folder=True) as store:
        store.add("walk.py", source)
    with closing(driver_named("process")) as driver:
        _, target = Stage(root, str(tmp_path), driver, "gymnasium").plan("walk.py")
    assert target.project is not None
    assert list(target.project.files) == ["sizes.py"]


def test_chosen_players_play_beside_the_others(corpus: Path) -> None:
    chosen = PolicyPlayer(PolicyFile("trained.py", POLICY), "trained")
    with closing(driver_named("process")) as driver:
        players = Stage(corpus, "", driver, "arcade", chosen=[chosen]).players("calm.py")
    assert list(players)[-2:] == ["policy 0", "trained"]
    assert {"random", "noop", "search"} <= players.keys()


def test_files_without_results_are_refused(corpus: Path, tmp_path: Path) -> None:
    for name, text in (("a.json", "{}"), ("b.json", '{"format": 2, "player": "x", "environments": []}')):
        (tmp_path / name).write_text(text)
        result = CliRunner().invoke(cli, ["explore", str(corpus), "--results", str(tmp_path / name)])
        assert result.exit_code == 2
        assert "`envcraft evaluate --output`" in result.output


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_are_accessible(show: Open, scheme: str) -> None:
    from playwright.sync_api import expect

    page = show(color_scheme=scheme)
    expect(page.locator("#rows li")).to_have_count(3)
    complaints = {"gallery": _complaints(page)}
    page.goto(f"{page.url}#environment=crash.py")
    expect(page.locator("#part-watch .players")).to_have_attribute("data-ready", "1")
    for summary in page.locator("#one summary").all():
        summary.click()
    complaints["environment"] = _complaints(page)
    page.goto(page.url.partition("environments.html")[0])
    complaints["corpus"] = _complaints(page)
    assert complaints == {"gallery": [], "environment": [], "corpus": []}


def _complaints(page: Page) -> list[str]:
    """What axe-core says against a page."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [f"{one['id']}: {node['html']} {node['failureSummary']}" for one in found for node in one["nodes"]]
