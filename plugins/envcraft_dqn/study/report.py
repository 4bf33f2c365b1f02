"""The report of a study as Markdown, HTML and JSON, with its figures."""

from __future__ import annotations

import platform
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from envcraft.errors import EnvCraftError
from envcraft_dqn.files import write_atomically
from envcraft_dqn.study.figures import draw, unit
from envcraft_dqn.study.metric import Interval, Pooled
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
from envcraft_dqn.study.worker import TaskResult

#: The results of the reference study with 1,000 variants: the share that improves, the steps and the percentage.
REFERENCE = ("68.7%", "+1.96", "+7.4 [4.97, 9.81]")
_TITLE = "Generalisation to held-out environments"
_NAMES = {
    AGENT: "the agent",
    PRETRAINED: "pretrained only",
    WITHOUT: "trained without demonstrations",
    UNTRAINED: "untrained network",
    NOOP: "doing nothing",
    FAMILIAR: "the agent, in environments of its training",
    PRIVILEGED: "privileged player (the ceiling)",
}
#: Settings that do not affect results, or that the table has already.
_OMITTED = ("seed", "replay", "compiled", "device")
#: One part of the page: a heading, a text, a figure with its caption, or the head and the rows of a table.
_Block = dict[str, Any]


def write(folder: Path, protocol: Protocol, player: str, results: Mapping[str, TaskResult], summary: Summary) -> Path:
    """Write the report and its figures.

    Args:
        folder: The folder of the study.
        protocol: The protocol.
        player: The name of the privileged player.
        results: The results of all tasks by name.
        summary: Their summary.

    Returns:
        The file with the Markdown report.

    Raises:
        EnvCraftError: A file cannot be written.
    """
    try:
        figures = draw(folder / "figures", protocol, results, summary)
        blocks = _blocks(protocol, player, summary, figures)
        data = msgspec.json.format(msgspec.json.encode(summary), indent=1) + b"\n"
        write_atomically(folder / "summary.json", data)
        for name in ("report.html", "report.md"):
            write_atomically(folder / name, _render(name, blocks))
    except OSError as error:
        raise EnvCraftError(f"{error.filename or folder} cannot be written: {error.strerror or error}") from None
    return folder / "report.md"


def _render(name: str, blocks: list[_Block]) -> str:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=name.endswith(".html"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["markdown"] = _escape_markdown
    return environment.get_template(f"{name}.j2").render(title=_TITLE, blocks=blocks)


def _escape_markdown(text: str) -> str:
    return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", text)


def _blocks(protocol: Protocol, player: str, summary: Summary, figures: list[tuple[str, str]]) -> list[_Block]:
    agent = summary.conditions[AGENT].over
    blocks: list[_Block] = [
        {"text": " ".join(filter(None, (_verdict("after all of its training", agent), _without_learning(summary))))}
    ]
    if PRETRAINED in summary.conditions:
        over = summary.conditions[PRETRAINED].over
        blocks.append({"text": _verdict("after pretraining on demonstrations alone", over)})
    blocks += [
        {"heading": "Comparison with the reference"},
        {"head": ["", "this study", "reference"], "rows": _reference(protocol, agent)},
        {
            "text": "The reference study had 1,000 other variants, 900 of them in each training, 1,000 episodes per "
            "environment, 250,000 updates of pretraining and about 9 million steps. This study has the scale "
            f"{protocol.scale}, with the settings at the end of this page. Compare it with its own controls."
        },
        {"heading": "The agent and its controls"},
        {"text": f"Means over environments with 95% confidence intervals (Student's t). Metric: {unit(protocol)}."},
        {
            "head": [
                "",
                "environments",
                "metric",
                "steps longer",
                "improve",
                "return higher",
                "own interval above zero",
                "own interval below zero",
                "the agent's lead",
            ],
            "rows": [_row(condition) for condition in summary.conditions.values()],
        },
        {
            "text": "Return higher: the share of environments with a mean return above that of random play. It can be "
            "small even if episodes are longer. The agent's lead: the mean paired difference of the metric between the "
            "agent and the condition, over the environments of both. Own interval: the number of environments whose "
            "own 95% confidence interval lies above or below zero."
        },
    ]
    if WITHOUT in summary.conditions:
        blocks.append(
            {
                "text": "The agent without demonstrations makes no updates of pretraining and takes more random "
                "actions. The lead over it is therefore not due to the demonstrations alone."
            }
        )
    if summary.gap is not None:
        blocks.append(
            {
                "text": "In the same environments, agents that trained on them lead the agent that did not by "
                f"{_interval(summary.gap)}, {_side(summary.gap, 'the latter', plural=True)}."
            }
        )
    if summary.without_scale:
        blocks.append(
            {
                "text": "Omitted, because the interval of the privileged player's lead over random play is not above "
                "zero: " + ", ".join(summary.without_scale)
            }
        )
    blocks += [{"figure": f"figures/{name}.png", "caption": caption} for name, caption in figures]
    if summary.conditions[AGENT].kinds:
        head = ["", "", "environments", "metric", "steps longer", "the agent's lead"]
        blocks += [{"heading": "By kind of environment"}, {"head": head, "rows": _kinds(summary)}]
    rows = [
        [f"split {number + 1}", f"{over.count}", _interval(over.value), _interval(over.steps, 2)]
        for number, over in summary.conditions[AGENT].splits.items()
    ]
    return [
        *blocks,
        {"heading": "By split"},
        {"head": ["", "environments", "metric", "steps longer"], "rows": rows},
        {"heading": "Settings"},
        {"head": ["", ""], "rows": _settings(protocol, player, summary)},
    ]


def _verdict(when: str, over: Pooled) -> str:
    interval = f"[{over.value.low:.1f}, {over.value.high:.1f}]"
    return (
        f"In {over.count} held-out environments, {when}, the mean of the metric is {over.value.mean:+.1f} with a 95% "
        f"confidence interval of {interval}, {_side(over.value, 'chance')}."
    )


def _without_learning(summary: Summary) -> str:
    """The comparison of the agent with controls that have learned nothing; empty without such controls."""
    leads = [
        f"over {name} {_interval(lead)}, {_side(lead, 'that')}"
        for condition, name in ((UNTRAINED, "an untrained network"), (NOOP, "doing nothing"))
        if condition in summary.conditions and (lead := summary.conditions[condition].agent) is not None
    ]
    return f"Its lead over controls that have learned nothing: {'; '.join(leads)}." if leads else ""


def _side(lead: Interval, other: str, plural: bool = False) -> str:
    """The position of an interval relative to zero, and its interpretation."""
    subject = "they perform" if plural else "it performs"
    if lead.low > 0:
        return f"above zero: {subject} better than {other}"
    if lead.high < 0:
        return f"below zero: {subject} worse than {other}"
    return f"on both sides of zero: the difference from {other} is not significant"


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
        _name(condition.name),
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
        conditions = [condition for condition in summary.conditions.values() if kind in condition.kinds]
        for number, condition in enumerate(conditions):
            over, lead = condition.kinds[kind]
            values = [f"{over.count}", _interval(over.value), _interval(over.steps)]
            rows.append(
                ["" if number else kind, _name(condition.name), *values, "" if lead is None else _interval(lead)]
            )
    return rows


def _name(condition: str) -> str:
    kind, _, number = condition.rpartition(" ")
    names = {SEED: f"another seed ({number})", SUBSET: f"trained on {number} environments"}
    return names.get(kind) or _NAMES[condition]


def _interval(interval: Interval, digits: int = 1) -> str:
    return f"{interval.mean:+.{digits}f} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def _settings(protocol: Protocol, player: str, summary: Summary) -> list[list[str]]:
    """The settings that reproduce the study, and its cost."""
    own = {
        "environments": f"{protocol.variants:,}",
        "folds": f"{protocol.folds}",
        "episodes per environment and player": f"{protocol.episodes:,}",
        "episodes of the privileged player": f"{protocol.privileged_episodes:,}",
        "random actions in tests": f"{protocol.epsilon:.0%}",
        "seed": f"{protocol.seed}",
        "splits with controls that need training": f"{protocol.controls}",
        "player of the demonstrations": player,
        "parameters of the network": f"{summary.parameters:,}",
        "processor hours": f"{summary.processor_seconds / 3600:.2f}",
        "hours of all tasks in sequence": f"{summary.seconds / 3600:.2f}",
        "processor": f"{platform.machine()}, {protocol.threads} threads per task",
    }
    training = msgspec.to_builtins(protocol.settings)
    rows = [[name, value] for name, value in own.items()]
    return rows + [
        [f"training: {name.replace('_', ' ')}", f"{value}"] for name, value in training.items() if name not in _OMITTED
    ]
