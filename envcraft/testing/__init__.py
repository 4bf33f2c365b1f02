"""Properties of your own environment, tested with Hypothesis: ``pip install 'envcraft-rl[test]'``.

Hypothesis draws seeds and actions, runs your test on them, and shortens those that break it. Your environment runs in
your own process, as in any test suite of yours: nothing here is isolated, so use ``envcraft validate`` for code that
you have not read.

Example::

    class LanternMachine(GymnasiumStateMachine):
        env_class = Lantern

        @invariant()
        def oil_is_never_negative(self):
            assert self.env.unwrapped.oil >= 0

    TestLantern = LanternMachine.TestCase
"""

from __future__ import annotations

import importlib.util

if importlib.util.find_spec("hypothesis") is None:
    raise ImportError("envcraft.testing needs hypothesis: `pip install 'envcraft-rl[test]'`")

from envcraft.testing.machine import GymnasiumStateMachine
from envcraft.testing.strategies import Episode, Step, actions, episodes, seeds

__all__ = ["Episode", "GymnasiumStateMachine", "Step", "actions", "episodes", "seeds"]
