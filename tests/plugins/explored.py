"""A small judged corpus for the explorer."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner

from envcraft.cli.group import cli
from envcraft.corpus.store import Store, generation
from envcraft.corpus.store.generation import AttemptRow, ConceptRow, OutcomeRow, PolicyRow
from evaluation.explorer import GAME

#: Text that would run as a script if a page took it for markup.
HOSTILE = "<img src=x onerror=document.title='owned'></script><script>document.title='owned'</script>"
POLICY = "def policy(env):\n    return [4, 0, 0]\n"


def fill(root: Path) -> None:
    """Make a corpus: a game that passes, one that crashes, one whose every text is hostile; and judge it."""
    with Store.create(root) as store:
        store.add("calm.py", GAME.format(words="a quiet zeppelin", crash=-1).encode(), origin={"concept": "c1"})
        store.add("crash.py", GAME.format(words="over the edge", crash=8).encode(), origin={"family": "walkers"})
        store.add(
            f"{HOSTILE}.py".replace("/", "_"), GAME.format(words=HOSTILE, crash=5).encode(), origin={"concept": HOSTILE}
        )
        for number, words in (("c1", "A calm walk"), (HOSTILE, HOSTILE)):
            generation.add_concepts(
                store, [ConceptRow(number, words, words, {"ingredients": [f"genre:{words}", "mechanic:ice-slide"]})]
            )
            generation.put_brief(store, number, f"Brief of {words}", {})
            for stage in ("viability", "code"):
                generation.put_outcome(store, OutcomeRow(number, stage, "passed", "", {}))
            source = store.put(b"import gymnasium\n")
            for attempt, diff in enumerate(("", f"--- a\n+++ b\n-{words}\n+walk\n")):
                row = AttemptRow(number, attempt, source, "", diff, "sound", "", "EC107", {}, None, {})
                generation.put_attempt(store, row)
            generation.put_policy(store, PolicyRow(number, 0, POLICY, 3, 4, "", {}))
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source,api", "--workers", "2")
    result = CliRunner().invoke(cli, ["audit", str(root), *options])
    assert result.exit_code == 1, result.output
