"""``envcraft explain``: what a rule means, from the check's own documentation."""

from __future__ import annotations

import click

from envcraft.cli.play.recorded import Played
from envcraft.errors import UsageError
from envcraft.judging.selection import all_checks
from envcraft.registry import did_you_mean


@click.command()
@click.argument("name", metavar="CODE|CHECK")
def explain(name: str) -> None:
    """Explain a rule (EC203) or a whole check (determinism)."""
    from rich.console import Console
    from rich.markdown import Markdown

    checks = {check.name: check for check in [*all_checks(), Played()]}
    rules = {rule.code: (rule, check) for check in checks.values() for rule in check.rules}
    console = Console(highlight=False)
    if name.upper() in rules:
        rule, check = rules[name.upper()]
        console.print(
            Markdown(
                f"**{rule.code} {rule.name}** ({rule.severity}, check `{check.name}`)\n\n{rule.summary}\n\n"
                f"Usual fix: {rule.fix}\n\n---"
            )
        )
    elif name.lower() in checks:
        check = checks[name.lower()]
    else:
        raise UsageError(f"there is no rule or check {did_you_mean(name, [*rules, *checks])}")
    console.print(Markdown(check.page))
