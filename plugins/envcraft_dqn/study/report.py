"""The report of a study: a page with its figures, and its numbers for other programs."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from pathlib import Path

import msgspec

from envcraft.errors import EnvCraftError
from envcraft_dqn.study.figures import draw, unit
from envcraft_dqn.study.metric import Interval, Pooled
from envcraft_dqn.study.page import Page
from envcraft_dqn.study.protocol import (
    AGENT,
    FAMILIAR,
    NOOP,
    PRETRAINED,
    PRIVILEGED,
    SEED,
    SUBSET,
    UNTRAINED,
    WITHOUT,
    Protocol,
)
from envcraft_dqn.study.summary import Condition, Summary
from envcraft_dqn.study.work import Result

#: What the study that this one follows came to, over 1,000 variants: the share that improves, steps, percent.
REFERENCE = ("68.7%", "+1.96", "+7.4 [4.97, 9.81]")
_WORDS = {
    AGENT: "the agent",
    PRETRAINED: "pretrained only",
    WITHOUT: "trained without demonstrations",
    UNTRAINED: "untrained network",
    NOOP: "doing nothing",
    FAMILIAR: "the agent, in environments of its training",
    PRIVILEGED: "privileged player (the ceiling)",
}


def write(folder: Path, protocol: Protocol, player: str, results: Mapping[str, Result], summary: Summary) -> Path:
    """Write the report into a study's folder; give its file as Markdown. Raises EnvCraftError."""
    try:
        figures = draw(folder / "figures", protocol, results, summary)
        page = _page(protocol, player, summary, figures)
        for name, text in (
            ("summary.json", msgspec.json.format(msgspec.json.encode(summary), indent=1).decode() + "\n"),
            ("report.html", page.html()),
            ("report.md", page.markdown()),
        ):
            (folder / f"{name}.new").write_text(text, "utf-8")
            os.replace(folder / f"{name}.new", folder / name)
    except OSError as error:
        raise EnvCraftError(f"{error.filename or folder} cannot be written: {error.strerror or error}") from None
    return folder / "report.md"


def _page(protocol: Protocol, player: str, summary: Summary, figures: list[tuple[str, str]]) -> Page:
    page = Page("Generalisation to environments that were held out")
    agent = summary.conditions[AGENT].over
    page.text(" ".join(filter(None, (_verdict("After all of its training", agent), _without_learning(summary)))))
    if PRETRAINED in summary.conditions:
        page.text(_verdict("After pretraining on demonstrations alone", summary.conditions[PRETRAINED].over))
    page.heading("Beside the reference")
    page.table(["", "this study", "reference"], _reference(protocol, agent))
    page.text(
        "The reference had 1,000 variants of its own, 900 of them in each training, 1,000 episodes for each "
        "environment, 250,000 updates of pretraining and about 9 million steps. This study is of the scale "
        f"{protocol.scale}, with the numbers at the end of this page; what it may be held against is its own controls."
    )
    page.heading("The agent and its controls")
    page.text(f"Mean over environments with a 95% interval (Student's t); the figure is the {unit(protocol)}.")
    head = [
        "",
        "environments",
        "figure",
        "steps longer",
        "improve",
        "return higher",
        "own interval above zero",
        "own interval below zero",
        "the agent's lead",
    ]
    page.table(head, [_row(condition) for condition in summary.conditions.values()])
    page.text(
        "Return higher: the share of environments in which the mean return is higher than that of random play, which "
        "need not be so where episodes are longer. The agent's lead is by how much its figure is the higher one, in "
        "the environments that both were tested in. Own interval: how many environments have one of their own, of 95%, "
        "that lies above zero, or below."
    )
    if WITHOUT in summary.conditions:
        page.text(
            "The agent without demonstrations makes no updates of pretraining and takes more of its steps at random, "
            "so that the lead over it is not the demonstrations' alone."
        )
    if summary.gap is not None:
        page.text(
            "In the same environments, the lead of agents that were trained on them over the one that was not is "
            f"{_interval(summary.gap)}, {_side(summary.gap, 'the latter')}."
        )
    if summary.without_scale:
        page.text(
            "Left out, since the interval of the privileged player's lead over random play is not above zero there: "
            + ", ".join(summary.without_scale)
        )
    for name, words in figures:
        page.figure(f"figures/{name}.png", words)
    if summary.conditions[AGENT].kinds:
        page.heading("By kind of environment")
        page.table(["", "", "environments", "figure", "steps longer", "the agent's lead"], _kinds(summary))
    page.heading("By split")
    rows = [
        [f"split {number + 1}", f"{over.count}", _interval(over.value), _interval(over.steps, 2)]
        for number, over in summary.conditions[AGENT].splits.items()
    ]
    page.table(["", "environments", "figure", "steps longer"], rows)
    _numbers(page, protocol, player, summary)
    return page


def _verdict(when: str, over: Pooled) -> str:
    interval = f"[{over.value.low:.1f}, {over.value.high:.1f}]"
    return (
        f"{when}, in {over.count} environments that it had not seen, the mean figure is {over.value.mean:+.1f} with a "
        f"95% interval of {interval}, {_side(over.value, 'chance')}."
    )


def _without_learning(summary: Summary) -> str:
    """How the agent stands against what has learnt nothing; "" where no such control was played."""
    leads = [
        f"over {words} {_interval(lead)}, {_side(lead, 'that')}"
        for name, words in ((UNTRAINED, "an untrained network"), (NOOP, "doing nothing"))
        if name in summary.conditions and (lead := summary.conditions[name].agent) is not None
    ]
    return f"Held against what has learnt nothing, its lead is {'; and '.join(leads)}." if leads else ""


def _side(lead: Interval, other: str) -> str:
    """Where the interval of a lead over another lies, and what that says."""
    if lead.low > 0:
        return f"above zero: it does better than {other}"
    if lead.high < 0:
        return f"below zero: it does worse than {other}"
    return f"on both sides of zero: this does not tell it from {other}"


def _reference(protocol: Protocol, agent: Pooled) -> list[list[str]]:
    improved, steps, percent = REFERENCE
    rows = [["environments that improve", f"{agent.improved.mean:.1%}", improved]]
    if protocol.metric == "length":
        rows.append(["steps longer, mean", f"{agent.steps.mean:+.2f}", steps])
        rows.append(["% longer, mean and 95% interval", _interval(agent.value, 2), percent])
    return rows


def _row(condition: Condition) -> list[str]:
    over = condition.over
    lead = "" if condition.agent is None else _interval(condition.agent)
    return [
        _called(condition.name),
        f"{over.count}",
        _interval(over.value),
        _interval(over.steps),
        f"{over.improved.mean:.0%}",
        f"{over.richer.mean:.0%}",
        f"{over.above}",
        f"{over.below}",
        lead,
    ]


def _kinds(summary: Summary) -> list[list[str]]:
    rows = []
    for kind in summary.conditions[AGENT].kinds:
        found = [(condition.name, condition.kinds[kind]) for condition in summary.conditions.values()
                 if kind in condition.kinds]  # fmt: skip
        for number, (name, (over, lead)) in enumerate(found):
            told = [
                f"{over.count}",
                _interval(over.value),
                _interval(over.steps),
                "" if lead is None else _interval(lead),
            ]
            rows.append(["" if number else kind, _called(name), *told])
    return rows


def _called(name: str) -> str:
    kind, _, number = name.rpartition(" ")
    return {SEED: f"another seed ({number})", SUBSET: f"trained on {number} environments"}.get(kind) or _WORDS[name]


def _interval(interval: Interval, digits: int = 1) -> str:
    return f"{interval.mean:+.{digits}f} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def _numbers(page: Page, protocol: Protocol, player: str, summary: Summary) -> None:
    """What it takes to do it again."""
    settings = protocol.settings
    page.heading("What it was run with")
    own = {
        "environments": f"{protocol.variants:,}",
        "folds": f"{protocol.folds}",
        "episodes of each environment and player": f"{protocol.episodes:,}",
        "episodes of the privileged player": f"{protocol.privileged_episodes:,}",
        "random actions of agents that are tested": f"{protocol.epsilon:.0%}",
        "seed": f"{protocol.seed}",
        "splits with controls that take a training": f"{protocol.controls}",
        "who demonstrates": player,
        "parameters of the network": f"{summary.parameters:,}",
        "processor hours": f"{summary.processor_seconds / 3600:.2f}",
        "hours, one task after the other": f"{summary.seconds / 3600:.2f}",
        "processor": f"{platform.machine()}, {protocol.threads} thread a task",
    }
    told = {name.replace("_", " "): f"{value}" for name, value in msgspec.to_builtins(settings).items()}
    left_out = ("seed", "replay", "compiled", "device")
    rows = [[name, value] for name, value in own.items()]
    rows += [[f"training: {name}", value] for name, value in told.items() if name not in left_out]
    page.table(["", ""], rows)
