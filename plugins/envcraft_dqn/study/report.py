"""The report of a study as Markdown, HTML and JSON, with its figures."""

from __future__ import annotations

import platform
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from envcraft.errors import EnvCraftError
from envcraft.text import plural
from envcraft_dqn.files import write_atomically
from envcraft_dqn.study.competence import Row
from envcraft_dqn.study.figures import draw, unit
from envcraft_dqn.study.metric import Interval, Pooled
from envcraft_dqn.study.protocol import (
    AGENT,
    COIN,
    CONSTANT,
    FAMILIAR,
    NOOP,
    PRETRAINED,
    PRIVILEGED,
    RANDOM,
    SEED,
    SHUFFLED,
    SUBSET,
    UNTRAINED,
    WITHOUT,
    Protocol,
)
from envcraft_dqn.study.summary import Condition, Summary
from envcraft_dqn.study.transfer import TransferSummary
from envcraft_dqn.study.worker import TaskResult

_TITLE = "Generalisation to held-out environments"
_NAMES = {
    AGENT: "the agent",
    PRETRAINED: "pretrained only",
    WITHOUT: "trained without demonstrations",
    UNTRAINED: "untrained network",
    NOOP: "doing nothing",
    RANDOM: "random play",
    COIN: "coin flip: random moves without buttons",
    CONSTANT: "the constant action that is best in training environments",
    SHUFFLED: "the agent's own actions in random order",
    FAMILIAR: "the agent, in environments of its training",
    PRIVILEGED: "privileged player (the ceiling)",
}
#: The controls of a headline.
_BESIDE = {RANDOM: "by random play", COIN: "by random moves without buttons"}
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


def section(summary: Summary) -> str:
    """The competence, the scaling curve and the settings of a study, as Markdown for a page with a title and parts."""
    protocol = summary.protocol
    training = protocol.settings
    size = (
        f"The study has {protocol.variants:,} environments{_where(protocol)} in {plural(protocol.folds, 'fold')}, of "
        f"which {plural(protocol.splits or protocol.folds, 'split')} ran. Each player played {protocol.episodes:,} "
        f"episodes in each environment, and the privileged player {protocol.privileged_episodes:,}. A training made "
        f"{summary.updates:,} updates of {training.batch:,} transitions and {summary.steps:,} online steps, with "
        f"{training.demonstrations:,} demonstrated steps of each environment. All tasks took "
        f"{summary.processor_seconds / 3600:.2f} processor hours, without the sandboxes of the privileged player."
    )
    return _render("section.md", [{"text": size}, *_competence(summary)])


def transfer_section(summary: TransferSummary) -> str:
    """The results of a transfer, as Markdown for a page with a title and parts."""
    return _render("section.md", _transfer(summary))


def headline(summary: Summary) -> str:
    """What a study found about its agent, in a few sentences of Markdown for a page about something else."""
    found = summary.competence
    rows = {row.condition: row for row in found.held_out}
    agent = rows[AGENT]
    trained = max((one.environments for one in found.sizes), default=0)
    begin = f"An agent trained on {trained:,} environments and played {agent.count:,} that it had not seen"
    if not found.passed:
        return f"{begin}. It does not beat every control in the environments of its own training.\n"
    scaled = _unsigned(agent.means["return"])
    text = f"{begin}. Its return is {scaled} on a scale from 0 (random play) to 100 (a player that sees the state)."
    if "goals" in agent.means:
        others = [f"{rows[one].means['goals'].mean:.2f} {words}" for one, words in _BESIDE.items() if one in rows]
        cleared = _unsigned(agent.means["goals"], 2)
        text += f" It clears {cleared} lines or groups in an episode, compared with {' and '.join(others)}."
    return text + "\n"


def _unsigned(interval: Interval, digits: int = 1) -> str:
    return f"{interval.mean:.{digits}f} [{interval.low:.{digits}f}, {interval.high:.{digits}f}]"


def _where(protocol: Protocol) -> str:
    """The axes that all environments share, in words."""
    return f" (all with {', '.join(protocol.where)})" if protocol.where else ""


def write_transfer(folder: Path, summary: TransferSummary) -> Path:
    """Write the report of a transfer, null results included; return its file. Raises EnvCraftError."""
    settings = [[name, f"{value}"] for name, value in msgspec.to_builtins(summary.protocol.settings).items()]
    blocks = [
        *_transfer(summary),
        {"heading": "Settings"},
        {
            "head": ["", ""],
            "rows": [
                ["environments of each family", f"{summary.protocol.variants}"],
                ["episodes", f"{summary.protocol.episodes}"],
                ["players of the demonstrations", summary.player],
                *settings,
            ],
        },
    ]
    try:
        data = msgspec.json.format(msgspec.json.encode(summary), indent=1) + b"\n"
        write_atomically(folder / "summary.json", data)
        for name in ("report.html", "report.md"):
            write_atomically(folder / name, _render(name, blocks, "Transfer to a family that the training left out"))
    except OSError as error:
        raise EnvCraftError(f"{error.filename or folder} cannot be written: {error.strerror or error}") from None
    return folder / "report.md"


def _transfer(summary: TransferSummary) -> list[_Block]:
    found, protocol, training = summary.families, summary.protocol, summary.protocol.settings
    size = (
        f"Each of the {len(found)} families has {protocol.variants:,} environments, of which one in {protocol.folds} "
        f"is held out. Each player played {protocol.episodes:,} episodes in each of them. An agent learned from "
        f"{training.demonstrations:,} demonstrated steps of each environment of the other families, in "
        f"{training.pretrain_updates:,} updates of {training.batch:,} transitions and {training.steps:,} online steps. "
        f"All tasks took {summary.processor_seconds / 3600:.2f} processor hours, without the sandboxes of the players."
    )
    steps = sorted({count for one in found for count in (*one.tuned, *one.scratch)})
    rows = [
        [one.family, f"{one.environments}", "no scale" if one.zero_shot is None else _interval(one.zero_shot)]
        for one in found
    ]
    curves = [
        [one.family, kind, *(_interval(known[count]) if count in known else "" for count in steps), _steps(half)]
        for one in found
        for kind, known, half in (
            ("after the other families", one.tuned, one.tuned_half),
            ("from random weights", one.scratch, one.scratch_half),
        )
    ]
    return [
        {"text": size},
        {
            "text": "For each family, an agent trained on all other families. Its return in held-out environments of "
            "the family is on a scale from 0 (random play) to 100 (the privileged player), with 95% intervals of a "
            "bootstrap over environments. There is no scale where the lead of the privileged player over random play "
            "is not significant."
        },
        {"head": ["left out", "environments", "zero-shot"], "rows": rows},
        {"heading": "Further training in the family"},
        {"head": ["family", "start", *(f"{count:,} steps" for count in steps), "steps to 50"], "rows": curves},
    ]


def _steps(count: int | None) -> str:
    return "not reached" if count is None else f"{count:,}"


def _render(name: str, blocks: list[_Block], title: str = _TITLE) -> str:
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
    return environment.get_template(f"{name}.j2").render(title=title, blocks=blocks)


def _escape_markdown(text: str) -> str:
    return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", text)


def _blocks(protocol: Protocol, player: str, summary: Summary, figures: list[tuple[str, str]]) -> list[_Block]:
    blocks = _competence(summary)
    if summary.competence.passed:
        agent = summary.conditions[AGENT].over
        blocks.append({"text": _verdict("after all of its training", agent)})
        if PRETRAINED in summary.conditions:
            over = summary.conditions[PRETRAINED].over
            blocks.append({"text": _verdict("after pretraining on demonstrations alone", over)})
    blocks += [
        {"heading": "Improvement by condition"},
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


def _competence(summary: Summary) -> list[_Block]:
    """The gate, the agent beside its controls, and the scaling curve."""
    found = summary.competence
    if found.passed:
        gate = (
            "The gate is passed: in environments of its own training, the agent leads every control in return, with "
            "intervals above zero. Figures on held-out environments therefore measure generalisation."
        )
    elif found.training:
        names = "; ".join(_name(one) for one in found.unbeaten)
        gate = (
            "The gate is not passed: in environments of its own training, the agent's lead in return is not above "
            f"zero over these controls: {names}. It has not learned to play, so no figure below measures "
            "generalisation."
        )
    else:
        gate = "The agent was not tested in environments of its training (--familiar), so the gate is closed."
    blocks: list[_Block] = [{"heading": "Competence"}, {"text": gate}]
    for rows, where in ((found.training, "environments of the training"), (found.held_out, "held-out environments")):
        if rows:
            head = [
                where,
                "environments",
                "return",
                "wins, %",
                "lines or groups",
                "length",
                "the agent's lead in return",
            ]
            head += ["in wins, %", "in lines or groups"]
            blocks.append({"head": head, "rows": [_competence_row(row) for row in rows]})
    blocks.append(
        {
            "text": "Return: on a scale from 0 (random play) to 100 (the privileged player) in each environment. "
            "Intervals: 95%, by a bootstrap over agents and their environments."
        }
    )
    if len(found.sizes) > 1:
        curve = [
            [f"{one.environments:,}", _interval(one.training), _interval(one.held_out), _interval(one.gap)]
            for one in found.sizes
        ]
        head = ["environments of the training", "training return", "held-out return", "gap"]
        blocks += [{"heading": "Scaling"}, {"head": head, "rows": curve}]
    return blocks


def _competence_row(row: Row) -> list[str]:
    def shown(known: dict[str, Interval], name: str) -> str:
        if name not in known:
            return ""
        factor = 100 if name == "wins" else 1
        some = Interval(*(factor * end for end in (known[name].mean, known[name].low, known[name].high)))
        return _unsigned(some, 2 if name == "goals" else 1)

    means = [shown(row.means, name) for name in ("return", "wins", "goals", "length")]
    leads = [shown(row.leads, name) for name in ("return", "wins", "goals")]
    return [_name(row.condition), f"{row.count}", *means, *leads]


def _side(lead: Interval, other: str, plural: bool = False) -> str:
    """The position of an interval relative to zero, and its interpretation."""
    subject = "they perform" if plural else "it performs"
    if lead.low > 0:
        return f"above zero: {subject} better than {other}"
    if lead.high < 0:
        return f"below zero: {subject} worse than {other}"
    return f"on both sides of zero: the difference from {other} is not significant"


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
        **({"axes with one value": ", ".join(protocol.where)} if protocol.where else {}),
        "folds": f"{protocol.folds}",
        "episodes per environment and player": f"{protocol.episodes:,}",
        "episodes of the privileged player": f"{protocol.privileged_episodes:,}",
        "random actions in tests": f"{protocol.epsilon:.0%}",
        "seed": f"{protocol.seed}",
        "splits with controls that need training": f"{protocol.controls}",
        "player of the demonstrations": player,
        "demonstrated steps recorded in each environment": f"{protocol.recorded:,}",
        "precision": " and ".join(summary.precisions),
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
