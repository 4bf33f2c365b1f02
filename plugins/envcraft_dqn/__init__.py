"""``envcraft train`` and ``envcraft evaluate``: one vision agent over many environments, a duelling double DQN."""
