"""The presets of ``--scale``."""

from __future__ import annotations

import msgspec

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
        recorded=40,
        num_envs=12,
        familiar=2,
        settings=Settings(
            size="tiny",
            objective="dagger",
            steps=160,
            pretrain_updates=30,
            demonstrations=40,
            num_envs=2,
            cycle=40,
            segment=20,
            batch=16,
            target_every=20,
            decay=True,
            temperature=1.0,
            epsilon_first=0.2,
            capacity=2_000,
            starts=20,
        ),
    ),
    # One panel of 100 held-out environments, and the scaling curve over the training environments. The boards have one
    # size and place: with boards of any size anywhere, a small agent did not learn to play in 1,000,000 steps.
    "laptop": Protocol(
        scale="laptop",
        where=(
            "board.rows=12",
            "board.columns=6",
            "board.shape=rectangle",
            "board.wrap=false",
            "look.panel=right",
        ),
        variants=1_000,
        folds=10,
        splits=1,
        episodes=10,
        privileged_episodes=3,
        # The simulator advises the learner from its first step.
        recorded=0,
        # The time goes into the agent and the scaling curve.
        controls=0,
        familiar=100,
        subsets=((300, 1), (100, 1), (30, 1), (10, 1)),
        settings=Settings(
            size="cells",
            objective="dagger",
            lead=0.5,
            steps=1_200_000,
            demonstrations=0,
            num_envs=64,
            cycle=500,
            batch=128,
            # Two states of three are learned from: others are cheaper than looking at one again.
            train_every=192,
            learning_rate=1e-3,
            decay=True,
            # States are learned from in proportion to how decisive the advice is.
            alpha=1.0,
            # Nearly greedy, because good actions have close values.
            temperature=0.1,
            epsilon_first=0.1,
            epsilon_last=0.1,
            capacity=150_000,
        ),
    ),
    # One large GPU: large batches of frames that stay on the device.
    "gpu": Protocol(
        scale="gpu",
        variants=1_000,
        folds=10,
        splits=1,
        episodes=100,
        privileged_episodes=10,
        recorded=1_000,
        num_envs=256,
        familiar=100,
        threads=8,
        subsets=((300, 1), (100, 1), (30, 1), (10, 1)),
        settings=Settings(
            size="reference",
            objective="dagger",
            augment="both",
            steps=1_000_000,
            pretrain_updates=10_000,
            demonstrations=1_000,
            num_envs=64,
            cycle=1_000,
            batch=1_024,
            train_every=50,
            decay=True,
            temperature=1.0,
            epsilon_first=0.05,
            epsilon_last=0.05,
            capacity=2_200_000,
            replay="device",
        ),
    ),
    "reference": Protocol(
        scale="reference",
        variants=1_000,
        folds=10,
        episodes=1_000,
        privileged_episodes=100,
        recorded=10_000,
        subsets=((700, 5), (500, 5), (300, 1), (100, 1)),
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

#: The presets of a transfer, with the variants of each family, of which a fold is for testing.
TRANSFER = {
    "smoke": msgspec.structs.replace(PRESETS["smoke"], variants=2, familiar=0),
    "laptop": msgspec.structs.replace(
        PRESETS["laptop"],
        variants=30,
        folds=5,
        splits=0,
        subsets=(),
        familiar=0,
        recorded=200,
        where=(),
        # The first training is on demonstrations alone, because players in sandboxes label some fifty states a second.
        settings=msgspec.structs.replace(
            PRESETS["laptop"].settings,
            size="patches",
            augment="mixed",
            temperature=0.5,
            learning_rate=1.5e-3,
            steps=0,
            pretrain_updates=2_000,
            demonstrations=200,
            train_every=25,
            # Labels that disagree in similar states have large errors for ever, so that priorities would favour them.
            alpha=0.0,
            lead=0.0,
        ),
    ),
    "gpu": msgspec.structs.replace(PRESETS["gpu"], variants=250, folds=5, splits=0, subsets=(), familiar=0),
}
#: The numbers of steps of further training in the family that was left out.
FURTHER = {"smoke": (40,), "laptop": (500, 2_000), "gpu": (10_000, 50_000, 250_000)}
