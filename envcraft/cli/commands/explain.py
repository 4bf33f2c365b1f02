"""``envcraft explain``: what a rule means, from its guide, and what a check does, from its page."""

from __future__ import annotations

import shlex

import click

from envcraft.cli import completion
from envcraft.cli.play.recorded import Played
from envcraft.errors import UsageError
from envcraft.judging.check import Check, Rule
from envcraft.judging.guide import Guide, guide_of
from envcraft.judging.selection import all_checks
from envcraft.registry import did_you_mean
from envcraft.text import plural

#: The most codes that a message lists.
_FEW = 20


@click.command()
@click.argument("name", metavar="CODE|CHECK", shell_complete=completion.codes_and_checks)
@click.option("--example", is_flag=True, help="Print only the code of the rule's example.")
def explain(name: str, example: bool) -> None:
    """Explain a rule (EC203) or a whole check (determinism)."""
    checks = {check.name: check for check in [*all_checks(), Played()]}
    rules = {rule.code: (rule, check) for check in checks.values() for rule in check.rules}
    # Reports show a rule's name beside its code.
    codes_of = {rule.name: code for code, (rule, _) in rules.items()}
    code = codes_of.get(name.lower(), name.upper())
    if code in rules and name.lower() not in checks:
        rule, check = rules[code]
        guide = guide_of(check, rule.code)
        if example:
            click.echo(_code(rule, guide), nl=False)
            return
        text = _page(rule, check, guide)
    elif name.lower() in checks and example:
        codes = ", ".join(rule.code for rule in checks[name.lower()].rules)
        raise UsageError(f"{name} is a check, and only a rule has an example; name one of {codes}")
    elif name.lower() in checks:
        text = checks[name.lower()].page
    elif name and (begun := [code for code in rules if code.startswith(name.upper())]):
        codes = ", ".join(begun if len(begun) <= _FEW else [*begun[:3], "…"])
        raise UsageError(f"{name} is the beginning of {plural(len(begun), 'code')}; name one of {codes}")
    else:
        raise UsageError(f"there is no rule or check {did_you_mean(name, [*rules, *checks, *codes_of])}")
    from rich.console import Console

    from envcraft.cli.page import Page

    # Wide lines of code stay whole, so that a copy of them runs.
    Console(highlight=False).print(Page(text), crop=False)


def _page(rule: Rule, check: Check, guide: Guide | None) -> str:
    head = f"**{rule.code} {rule.name}** ({rule.status}, check `{check.name}`)\n\n{rule.summary}\n\n"
    if guide is None:
        return f"{head}Usual fix: {rule.fix}\n\n---\n\n{check.page}"
    return (
        f"{head}"
        f"## Why is this bad?\n{guide.harm}\n\n"
        f"## Example\n{guide.example}\n\n"
        f"## Usual fix\n{rule.fix}\n\n"
        f"## How it is detected\n{guide.detected}\n\n"
        f"## What it misses\n{guide.missed}\n\n---\n\n"
        f"`envcraft explain {check.name}` explains the whole check. To try the example:\n\n"
        f"{_commands(rule, check, guide)}"
    )


def _commands(rule: Rule, check: Check, guide: Guide) -> str:
    """The commands that judge the example, as a block of code."""
    example, file = guide.code(), f"{rule.code}.py"
    options = [word for name, value in example.settings.items() for word in (f"--{name}", value)]
    options += ["--checks", check.name] if check.opt_in else []
    options += [] if rule.default else ["--select", rule.code]
    if example.policy:
        options += ["--policy", "policy.py"]
    return (
        f"```sh\nenvcraft explain {rule.code} --example > {file}\n"
        f"{shlex.join(['envcraft', 'validate', file, *options])}\n```"
    )


def _code(rule: Rule, guide: Guide | None) -> str:
    """The code of the example. Raises UsageError if the rule has none."""
    if guide is None:
        raise UsageError(f"{rule.code} has no example")
    return guide.code().source
