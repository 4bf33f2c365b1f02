"""What the tests of corpora share: a store with verdicts of every kind, made without judging anything."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from envcraft.cli import cli
from envcraft.contract import ARCADE
from envcraft.corpus.settings import Settings, contract_digest
from envcraft.corpus.store import Environment, Store
from envcraft.verdict import CheckReport, Finding, Severity, SubjectReport, Verdict

SETTINGS = Settings("arcade", contract_digest(ARCADE), "0.1.0+rules", 0, "quick", "process", "python 3")
Invoke = Callable[..., Result]


def source(name: str) -> bytes:
    """A file that a folder's environments are known by, without being one."""
    return f"import gymnasium\nclass {name.title()}(gymnasium.Env):\n    pass\n".encode()


def report(name: str, *codes: str, verdict: Verdict | None = None, steps: int = 7) -> SubjectReport:
    findings = [Finding(code, Severity.ERROR, f"{code} was found", 3, {"share": 0.5}) for code in codes]
    verdict = verdict or (Verdict.FAIL if codes else Verdict.PASS)
    sha256 = hashlib.sha256(source(name)).hexdigest()
    return SubjectReport(
        name, name.title(), sha256, verdict, "process", 0.25, steps, [CheckReport("api", verdict, 0.1, findings)]
    )


def judged(store: Store, name: str, *codes: str, verdict: Verdict | None = None) -> None:
    """Add an environment with a verdict."""
    store.add(name, source(name))
    environment = Environment(name, hashlib.sha256(source(name)).hexdigest(), "")
    store.record(environment, store.settings(SETTINGS), report(name, *codes, verdict=verdict))


def rows(store: Store) -> list[tuple[object, ...]]:
    """Everything but numbers and times."""
    return [
        *store.db.execute(
            "SELECT name, e.source, e.class, origin, v.verdict, v.steps, v.report FROM environments e "
            "LEFT JOIN verdicts v ON v.id = e.verdict ORDER BY name"
        ),
        *store.db.execute(
            "SELECT v.source, v.class, s.digest, v.verdict, v.report FROM verdicts v JOIN settings s "
            "ON s.id = v.settings ORDER BY 1, 2, 3"
        ),
        *store.db.execute(
            "SELECT v.source, number, rule_check, code, severity, line, message FROM findings f JOIN verdicts v "
            "ON v.id = f.verdict ORDER BY 1, 2"
        ),
    ]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    """A corpus of four: one passes, one fails, one could not be judged, one was not."""
    with Store.create(tmp_path / "corpus") as made:
        judged(made, "ant")
        judged(made, "bee", "EC107", "EC203")
        judged(made, "cat", verdict=Verdict.ERROR)
        made.add("dog", source("dog"), origin={"model": "a"})
        yield made


@pytest.fixture
def invoke(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Invoke:
    """Run the command line in an empty folder, where no configuration reaches it."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str | Path) -> Result:
        return CliRunner().invoke(cli, [str(argument) for argument in arguments])

    return run


@pytest.fixture(scope="session")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A corpus with verdicts of every kind and three pictures, and the report on it."""
    from .reported import HOSTILE, fill, picture, written

    folder = tmp_path_factory.mktemp("reported")
    with Store.create(folder / "corpus") as made:
        fill(made)
        for name in (HOSTILE, "games/env0001.py", "games/env0002.py"):
            picture(made, name)
    return folder / "corpus", written(folder / "corpus", folder / "report")
