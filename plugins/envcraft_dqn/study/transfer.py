"""Transfer to a family of games that the training left out.

For each family, an agent trains on all other families. It is tested in the family without further training, and after
training there for several numbers of steps. An agent from random weights trains for the same numbers of steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from envcraft.errors import UsageError
from envcraft_dqn.study.folds import Split, splits
from envcraft_dqn.study.metric import Interval, Score, bootstrap, by_return
from envcraft_dqn.study.protocol import PRIVILEGED, RANDOM, Protocol, Task
from envcraft_dqn.study.selection import StudyEnv
from envcraft_dqn.study.worker import TaskResult

#: An agent from all other families, the same after training in the family, and one from random weights.
ZERO_SHOT, TUNED, SCRATCH = "zero-shot", "tuned", "from scratch"
#: The scaled return that counts as half of the privileged player's.
_HALF = 50.0


class Transfer(msgspec.Struct, frozen=True):
    """The results of one family.

    Attributes:
        family: The family that the training left out.
        environments: The number of test environments with a scale.
        zero_shot: The scaled return of the agent from all other families; None if no test environment has a scale.
        tuned, scratch: The scaled returns by the number of steps in the family.
        tuned_half, scratch_half: The least of these numbers at which the mean is half of the privileged player's; None
            if none is enough.
    """

    family: str
    environments: int
    zero_shot: Interval | None
    tuned: dict[int, Interval]
    scratch: dict[int, Interval]
    tuned_half: int | None
    scratch_half: int | None


class TransferSummary(msgspec.Struct, frozen=True):
    """The results of a transfer.

    Attributes:
        protocol: The protocol.
        player: The names of the players of the demonstrations.
        families: The results of each family, sorted by name.
        processor_seconds: The total time of all tasks, without the sandboxes of the players.
    """

    protocol: Protocol
    player: str
    families: list[Transfer]
    processor_seconds: float


def transfer_tasks(protocol: Protocol, environments: Sequence[StudyEnv], steps: Sequence[int]) -> list[Task]:
    """All tasks of a transfer.

    Args:
        protocol: The protocol. Each family is split into its folds, and the first fold is for testing.
        environments: The environments.
        steps: The numbers of steps of further training.

    Raises:
        UsageError: There are fewer than two families, or the protocol is invalid.
    """
    protocol.check()
    families = sorted({one.family for one in environments})
    if len(families) < 2 or not all(families):
        present = " and ".join(families) or "none"
        raise UsageError(f"a transfer needs environments of two families or more, and these are of {present}")
    parts = {
        family: splits([one.name for one in environments if one.family == family], protocol.folds, protocol.seed)[0]
        for family in families
    }
    found = []
    for number, family in enumerate(families):
        own = parts[family]
        others = tuple(sorted(name for other in families if other != family for name in parts[other].train))
        seed = protocol.seed + 1_000 * number

        def play(condition: str, player: str, after: str = "", own: Split = own, number: int = number) -> Task:
            # Players need episodes other than those of random play, and the same as each other.
            episodes = protocol.seed + 1_000 * (1 + number) + (player != RANDOM)
            name = f"{families[number]}.play.{condition.replace(' ', '-')}"
            waits = (after,) if after else ()
            return Task(name, "play", condition, number, own.test, player, episodes, after=waits)

        source = Task(f"{family}.train.source", "train", "source", number, others, seed=seed)
        first = f"runs/{source.name}/agent.safetensors"
        found += [play(RANDOM, RANDOM), play(PRIVILEGED, PRIVILEGED), source, play(ZERO_SHOT, first, source.name)]
        for count in steps:
            for condition, initial in ((TUNED, first), (SCRATCH, "")):
                training = Task(
                    f"{family}.train.{condition.replace(' ', '-')}-{count}",
                    "train",
                    f"{condition} {count}",
                    number,
                    own.train,
                    seed=seed,
                    demonstrations=False,
                    after=(source.name,) if initial else (),
                    initial=initial,
                    steps=count,
                )
                agent = f"runs/{training.name}/agent.safetensors"
                found += [training, play(f"{condition} {count}", agent, training.name)]
    return found


def summarise_transfer(
    protocol: Protocol, player: str, results: Mapping[str, TaskResult], environments: Sequence[StudyEnv]
) -> TransferSummary:
    """Summarise the results of a transfer.

    Args:
        protocol: The protocol.
        player: The names of the players of the demonstrations.
        results: The results of the tasks by name.
        environments: The environments.
    """
    scores: dict[tuple[int, str], list[Score]] = {}
    for result in results.values():
        if result.task.kind == "play":
            scores[result.task.split, result.task.condition] = result.scores
    found = []
    for number, family in enumerate(sorted({one.family for one in environments})):
        random = {score.name: score for score in scores[number, RANDOM]}
        ceiling = {score.name: score for score in scores[number, PRIVILEGED]}
        values: dict[str, Interval] = {}
        count = 0
        for (split, condition), played in scores.items():
            if split != number or condition in (RANDOM, PRIVILEGED):
                continue
            changes = [by_return(score, random[score.name], ceiling[score.name], split) for score in played]
            if scaled := [change.value for change in changes if change is not None]:
                values[condition], count = bootstrap({split: scaled}), len(scaled)
        tuned, scratch = (_by_steps(values, condition) for condition in (TUNED, SCRATCH))
        first = values.get(ZERO_SHOT)
        halves = _half({**({} if first is None else {0: first}), **tuned}), _half(scratch)
        found.append(Transfer(family, count, first, tuned, scratch, *halves))
    return TransferSummary(protocol, player, found, sum(result.processor_seconds for result in results.values()))


def _by_steps(values: Mapping[str, Interval], condition: str) -> dict[int, Interval]:
    known = {int(name.rpartition(" ")[2]): one for name, one in values.items() if name.startswith(condition)}
    return dict(sorted(known.items()))


def _half(values: Mapping[int, Interval]) -> int | None:
    return next((steps for steps, interval in sorted(values.items()) if interval.mean >= _HALF), None)
