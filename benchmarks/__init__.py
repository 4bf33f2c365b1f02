"""Benchmarks: each figure in the README, measured in one run beside the peer that it is compared with."""

import os

# Games that a benchmark plays without a sandbox open no window and play no sound.
os.environ |= {"SDL_VIDEODRIVER": "dummy", "SDL_AUDIODRIVER": "dummy", "PYGAME_HIDE_SUPPORT_PROMPT": "1"}
