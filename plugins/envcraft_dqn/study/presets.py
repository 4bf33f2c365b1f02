"""The presets of ``--scale``."""

from __future__ import annotations

from envcraft_dqn.settings import Settings
from envcraft_dqn.study.protocol import Protocol

PRESETS = {
    # A functional test.
    "smoke": Protocol(
        scale="smoke",
        variants=6,
        folds=2,
        episodes=3,
        privileged_episodes=2,
        num_envs=12,
        familiar=2,
        settings=Settings(
            size="tiny",
            steps=160,
            pretrain_updates=30,
            demonstrations=40,
            num_envs=2,
            cycle=40,
            segment=20,
            batch=16,
            target_every=20,
            epsilon_first=0.2,
            capacity=2_000,
            starts=20,
        ),
    ),
    "laptop": Protocol(
        scale="laptop",
        variants=60,
        folds=5,
        episodes=50,
        privileged_episodes=3,
        familiar=8,
        settings=Settings(
            size="small",
            steps=12_000,
            pretrain_updates=4_000,
            demonstrations=1_000,
            num_envs=8,
            cycle=250,
            segment=250,
            target_every=500,
            epsilon_first=0.1,
            epsilon_last=0.1,
            demonstration_share=0.5,
            capacity=90_000,
        ),
    ),
    "reference": Protocol(
        scale="reference",
        variants=1_000,
        folds=10,
        episodes=1_000,
        privileged_episodes=100,
        num_envs=256,
        controls=2,
        familiar=100,
        threads=8,
        settings=Settings(
            size="reference",
            steps=9_000_000,
            pretrain_updates=250_000,
            demonstrations=1_000,
            num_envs=16,
            epsilon_first=1.0,
            epsilon_last=0.1,
            capacity=10_500_000,
        ),
    ),
}
