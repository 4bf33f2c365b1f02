"""``envcraft.make_vec(..., fast=True)``: environments that their family plays by a program of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from envcraft.errors import UsageError
from envcraft.families import Generated
from envcraft.using.sources import Found

if TYPE_CHECKING:
    from envcraft.using.vector import Running


def simulator(found: Sequence[Found]) -> Running:
    """What plays these environments, which one family has written.

    Raises UsageError where that is not so, where the contract changes what a file does, or the family has no such
    program.
    """
    from envcraft.commands.choices import family_named

    families = {one.origin.get("family", ""): one.name for one in found}
    if "" in families:
        raise UsageError(f"fast=True plays what `envcraft generate` wrote into a corpus, and not {families['']}")
    if len(families) > 1:
        names = ", ".join(f"{name} of {family}" for family, name in families.items())
        raise UsageError(f"fast=True plays environments of one family, and these are of several: {names}")
    for one in found:
        if one.contract.adapter:
            raise UsageError(
                f"fast=True plays {one.name} as its file does, and the contract {one.contract.name} adapts that: "
                "choose another contract, or leave fast out"
            )
    generated = [Generated(one.name.removesuffix(".py"), one.source.decode(), one.origin) for one in found]
    return family_named(next(iter(families))).simulate(generated)
