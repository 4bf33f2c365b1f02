"""Audits on a Dask cluster of real worker processes, one of which is killed, and one that is interrupted."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import signal
import socket
import sqlite3
import ssl
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from click.testing import CliRunner

from envcraft.cli.group import cli
from envcraft.corpus.store import DATABASE, Store, decode
from envcraft.errors import EnvCraftError, UsageError

COUNT = 8
OPTIONS = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--executor", "dask", "--workers", "2")
#: Each takes its time to be loaded, and none of the machine's.
SOURCE = """import time

import gymnasium

time.sleep(0.4)


class Walk(gymnasium.Env):
    {name} = 0

    def reset(self, *, seed=None, options=None):
        return 0, {{}}

    def step(self, action):
        return 0, 0.0, False, False, {{}}
"""
_WRITES = """
CREATE TABLE writes (source TEXT);
CREATE TRIGGER made AFTER INSERT ON verdicts BEGIN INSERT INTO writes VALUES (new.source); END;
CREATE TRIGGER changed AFTER UPDATE ON verdicts BEGIN INSERT INTO writes VALUES (new.source); END;
"""


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    """A corpus that counts how often a verdict is written."""
    with Store.create(tmp_path / "corpus") as store:
        for number in range(COUNT):
            store.add(f"e{number}.py", SOURCE.format(name=f"n{number}" if number else "1").encode())
        store.db.executescript(_WRITES)
    return tmp_path / "corpus"


def writes(corpus: Path) -> Counter[str]:
    with sqlite3.connect(corpus / DATABASE) as db:
        return Counter(source for (source,) in db.execute("SELECT source FROM writes"))


@pytest.fixture
def audit(corpus: Path) -> Iterator[subprocess.Popen[str]]:
    """An audit that has come to its second verdict, and not to its last but two."""
    command = [sys.executable, "-m", "envcraft", "audit", str(corpus), *OPTIONS]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=corpus.parent, start_new_session=True
    )
    deadline = time.monotonic() + 240
    while (judged := writes(corpus).total()) < 2 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert 2 <= judged < COUNT - 2
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


def below(parent: int) -> dict[int, str]:
    """The command lines of the processes below one."""
    lines: dict[int, str] = {}
    parents: dict[int, int] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with contextlib.suppress(OSError):
                lines[int(folder.name)] = (folder / "cmdline").read_text("utf-8", "replace")
                parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
    found = {parent}
    while more := {child for child, above in parents.items() if above in found} - found:
        found |= more
    return {pid: lines[pid] for pid in found - {parent}}


def test_a_worker_that_is_killed_costs_nothing(audit: subprocess.Popen[str], corpus: Path) -> None:
    workers = [pid for pid, line in below(audit.pid).items() if "multiprocessing.spawn" in line]
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    out, error = audit.communicate(timeout=400)
    assert audit.returncode == 1, error
    assert f"{COUNT} environments: {COUNT - 1} passed, 1 failed" in out
    # Nothing of what Dask has to say about it: only how far it has come.
    first, *progress = error.splitlines()
    assert first == f"{COUNT} environments, {COUNT} of them to be judged"
    assert all(f" of {COUNT} judged" in line for line in progress), error
    assert set(writes(corpus).values()) == {1}
    with Store(corpus) as store:
        rows = store.db.execute(
            "SELECT name, v.report FROM environments e JOIN verdicts v ON v.id = e.verdict ORDER BY name"
        ).fetchall()
        assert store.db.execute("SELECT count(*) FROM verdicts").fetchone() == (COUNT,)
    assert [(name, decode(report).path) for name, report in rows] == [(f"e{n}.py", f"e{n}.py") for n in range(COUNT)]


def test_ctrl_c_ends_it_at_once(audit: subprocess.Popen[str], corpus: Path) -> None:
    started = below(audit.pid)
    begun = time.monotonic()
    # As a terminal does it.
    os.killpg(audit.pid, signal.SIGINT)
    _, error = audit.communicate(timeout=480)
    took = time.monotonic() - begun
    assert audit.returncode == 130, error
    assert error.splitlines()[-2].endswith("were judged and stored; the same command resumes")
    assert not {"Traceback", "distributed"} & set(re.findall(r"\w+", error)), error
    assert took < 60
    assert set(writes(corpus).values()) == {1}
    deadline = time.monotonic() + 60
    while (left := [pid for pid in started if Path(f"/proc/{pid}").exists()]) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not left


def test_local_cluster_requires_its_certificate() -> None:
    from envcraft_dask.plugin import DaskExecutor

    # As somebody has it who has no certificate.
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    # Later versions tell of a refusal only after the handshake.
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    with DaskExecutor().open(1, None) as opened:
        assert opened.executor.submit(abs, -3).result(timeout=240) == 3
        executor: Any = opened.executor
        address = urlsplit(executor._client.scheduler.address)
        assert (address.scheme, address.hostname) == ("tls", "127.0.0.1")
        with (
            socket.create_connection(("127.0.0.1", address.port), timeout=240) as raw,
            pytest.raises((ssl.SSLError, ConnectionError)),
        ):
            context.wrap_socket(raw)


def test_executor_dask_without_the_library_is_a_usage_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "distributed" else found(name))
    result = CliRunner().invoke(cli, ["audit", str(tmp_path), "--executor", "dask", "--sandbox", "process"])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == "Error: --executor dask needs Dask; install it with `pip install 'envcraft-rl[dask]'`\n"


def test_unreachable_scheduler_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    from envcraft_dask import plugin

    monkeypatch.setattr(plugin, "_CONNECT_SECONDS", 0.2)
    dask: Any = plugin.DaskExecutor()
    with pytest.raises(UsageError, match="is not the address of a Dask scheduler"), dask.open(None, "nosuch://x"):
        pass
    words = r"no Dask scheduler answers at --scheduler tcp://127\.0\.0\.1:1 "
    with pytest.raises(EnvCraftError, match=words), dask.open(None, "tcp://127.0.0.1:1"):
        pass
