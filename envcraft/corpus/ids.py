"""The Gymnasium id of an environment: ``EnvCraft/<name>-v0``.

A name without its ``.py`` is its own id as far as Gymnasium allows: letters, digits, ``_``, ``-``, and single dots
between those. A slash becomes two dots. Any other sign becomes its code point in hexadecimal between ``..x`` and
``..``. A name that does not end in ``.py`` gets ``..x..`` at its end. No two names have the same id.
"""

from __future__ import annotations

import re

NAMESPACE = "EnvCraft"
#: What an id cannot contain as it is: a dot at an end or beside another sign, and any other sign.
_ODD = re.compile(r"(?<![\w-])\.|\.(?![\w-])|[^\w.-]")


def identifier(name: str, namespace: str = NAMESPACE) -> str:
    """The id of the environment `name`."""
    stem = name.removesuffix(".py")
    return f"{namespace}/{_ODD.sub(_escape, stem)}{'' if stem != name else '..x..'}-v0"


def _escape(odd: re.Match[str]) -> str:
    # With an x after it, two dots would read as the beginning of a code point.
    slash = odd[0] == "/" and odd.string[odd.end() : odd.end() + 1] != "x"
    return ".." if slash else f"..x{ord(odd[0]):x}.."
