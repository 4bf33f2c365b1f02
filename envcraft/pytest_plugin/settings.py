"""The plugin's settings, and the category of its warnings. pytest imports this module in every run."""

from __future__ import annotations

#: Options of the command line and of pytest's configuration, each with its help.
SETTINGS = {
    "contract": "the contract that the environments promise",
    "budget": "how much to play: quick, standard or thorough",
    "sandbox": "the sandbox that runs the environments",
    "seed": "the seed of all episodes",
    "time_limit": "the longest time of each environment in seconds",
    "checks": "run only these checks, separated by commas; source and sandbox always run",
    "skip": "do not run these checks, separated by commas",
}


class EnvCraftWarning(UserWarning):
    """A finding of severity warning."""
