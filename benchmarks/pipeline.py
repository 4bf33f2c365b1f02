"""``python -m benchmarks.pipeline``: the cost of the generation pipeline without the model and the checker.

Concepts pass through every stage into a corpus, as with ``envcraft generate``. The model and the checker respond at
once: every environment is repaired once and gets one policy. A journal keeps each response; the corpus keeps each
source, diff, verdict and outcome. The time is the CPU time of all threads of this process; it includes making the
concepts, but not the start of Python.

The exit status is 1 if an environment takes more than 25 times as long as compiling its source, in the same run.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
from envcraft_llm.concepts.generation import concepts
from envcraft_llm.endpoint.journal import Journal
from envcraft_llm.model import Completion, Model, Request
from envcraft_llm.pipeline.context import CorpusContext
from envcraft_llm.pipeline.runner import PipelineRunner
from envcraft_llm.pipeline.tables import rows, stage_table
from envcraft_llm.stages import STAGES
from envcraft_llm.stages.briefs import SECTIONS
from rich.console import Console

from envcraft.contracts.builtin import ARCADE
from envcraft.corpus.store import Store, environments
from envcraft.generation.history import History
from envcraft.generation.stages import ConceptState, Stage
from envcraft.judging.settings import Settings, contract_digest
from envcraft.model.stage_order import ordered
from envcraft.model.target import Target
from envcraft.model.verdict import CheckReport, Finding, Repro, Severity, SubjectReport, Verdict

LIMIT, NUMBER = 25, 200
#: How often the source is compiled before the concepts and again after them.
_COMPILED = 50
_GAME = Path(__file__).parent.parent / "examples" / "sokoban.py"
_SETTINGS = Settings("arcade", contract_digest(ARCADE), "benchmark", 0, "quick", "none", "none")
_PROFILE = {"steps": 5000, "frames": 2000, "rewards": 8, "moves": 8, "longest": 1000}
_CHECKS = (
    "source",
    "api",
    "determinism",
    "reward",
    "observation",
    "termination",
    "instawin",
    "instadeath",
    "difficulty",
)
_POLICY = "class Policy:\n    def act(self, state):\n        return [0, 0, 0]\n"


class Instant(Model):
    """Responds at once and keeps each response in a journal."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        sentence = "The crate moves one cell in 4 steps when the pusher leans on it, and 3 crates open the door. "
        body = "\n\n".join(f"## {section}\n\n{sentence * 14}" for section in SECTIONS)
        game = _GAME.read_text("utf-8")
        self._texts = {
            "briefs": f"# Crates\n\n{body}\n",
            "viability": json.dumps({"viable": True, "objections": [], "summary": "Crates."}),
            "code": f"Here it is.\n\n```python\n{game}# before\n```\n",
            "repair": f"Mended.\n\n```python\n{game}```\n",
            "privileged": f"```python\n{_POLICY}```\n",
        }
        self.requests = 0

    async def generate(self, request: Request) -> Completion:
        # Each concept gets a different source, as from a real model.
        text = self._texts[request.stage].replace('"""\n', f'"""\n# {request.concept}\n', 1)
        answer = Completion(text, model="instant")
        self.requests += 1
        await self._journal.put(request, answer)
        return answer

    async def close(self) -> None:
        self._journal.close()


class Costless:
    """JudgeExecutor without playing: a marked source has a finding, all others pass, and every policy wins."""

    workers, under_way = 2, 0

    async def judge(self, target: Target) -> tuple[SubjectReport, dict[str, Any]]:
        return _report(target, target.source.endswith(b"# before\n")), _PROFILE

    async def play(self, target: Target, policy: str) -> tuple[SubjectReport, tuple[int, int]]:
        return _report(target, False), (6, 6)


def _report(target: Target, faulty: bool) -> SubjectReport:
    found = Finding("EC107", Severity.ERROR, "step() raises IndexError", 120, {}, Repro(0, [[1, 0, 0]] * 40))
    checks = [CheckReport(name, Verdict.PASS, 0.5) for name in _CHECKS]
    if faulty:
        checks[1] = CheckReport("api", Verdict.FAIL, 0.5, [found])
    overall = Verdict.FAIL if faulty else Verdict.PASS
    return SubjectReport(target.path, "Sokoban", target.sha256, overall, "process", 3.0, 20_000, checks)


def taken(number: int, folder: Path) -> tuple[float, float, int, list[str]]:
    """CPU seconds, wall-clock seconds, requests and the table for this many concepts."""
    clock, cpu = time.perf_counter(), time.process_time()
    stages: list[Stage] = ordered([kind() for kind in STAGES])
    states = [ConceptState(one.id, one.title, one.text, msgspec.to_builtins(one)) for one in concepts(number, 0)]
    with Store.create(folder / "corpus") as store:
        history = History(store, _SETTINGS)
        history.keep_concepts(states)
        ids = [state.concept for state in states]
        model = Instant(Journal(store.root))
        context = CorpusContext(history, model, Costless(), lambda stage: "instant")  # type: ignore[arg-type]

        async def run() -> None:
            await PipelineRunner(history, stages).run(ids, context, 128)
            await model.close()

        asyncio.run(run())
        table = stage_table(rows(history, stages, ids))
        made = environments.count(store)
        assert made == number, f"{made} environments of {number} concepts: {table}"
    return time.process_time() - cpu, time.perf_counter() - clock, model.requests, table


def compiling() -> float:
    """CPU seconds to compile the game's source."""
    text, started = _GAME.read_text("utf-8"), time.process_time()
    for _ in range(_COMPILED):
        compile(text, _GAME.name, "exec")
    return (time.process_time() - started) / _COMPILED


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures; return 1 if the limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pipeline", description=__doc__)
    parser.add_argument("--number", type=int, default=NUMBER, help="how many concepts")
    options = parser.parse_args(arguments)
    before = compiling()
    with tempfile.TemporaryDirectory(prefix="envcraft-pipeline-") as folder:
        cpu, clock, requests, table = taken(options.number, Path(folder))
    unit = (before + compiling()) / 2
    console = Console(width=120)
    for line in table:
        console.print(line, markup=False)
    each = cpu / options.number
    console.print(
        f"{options.number:,} environments, {requests:,} requests: {cpu:.2f} s of CPU, {clock:.2f} s; "
        f"{each * 1000:.1f} ms of CPU per environment, {each / unit:.1f} times compiling its source; at most {LIMIT}"
    )
    return int(each > LIMIT * unit)


if __name__ == "__main__":
    raise SystemExit(main())
