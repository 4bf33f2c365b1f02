"""Plays whole episodes in the sandbox, for the page to play back: of players, and of findings' reproductions."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from envcraft.corpus.report.episodes import FRAMES, episode, shown, tiles
from envcraft.demonstrations.player import Player
from envcraft.errors import Skip, UsageError
from envcraft.judging.check import Check
from envcraft.judging.frame_renderer import with_frames
from envcraft.judging.subject import Subject
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding
from envcraft_explorer.stage import rate_of


class Recorded(NamedTuple):
    """An episode for the page: its data without the picture, and the picture; None if there is none to show."""

    data: dict[str, Any]
    picture: bytes | None


def of_player(subject: Subject, player: Player, number: int) -> Recorded:
    """Let a player play one episode.

    Args:
        subject: the environment, opened with the player's policy if it has one.
        player: who plays.
        number: of the episode, which gives its seed.

    Raises:
        UsageError: the player cannot play it.
        EnvCraftError: the sandbox failed.
    """
    try:
        trace = player.play(subject, number)
        again = Rollout(trace.rollout.seed, trace.actions, player=f"the player {player.name}")
        return _recorded(subject, again, player.name)
    except Skip as skip:
        raise UsageError(f"the player {player.name} cannot play it: {skip}") from None


def of_finding(subject: Subject, check: Check | None, finding: Finding, number: int) -> Recorded:
    """Run the reproduction of a finding again, and say whether the defect shows.

    Args:
        subject: the environment.
        check: the check that found it; None if it is not installed.
        finding: the finding.
        number: of the finding on the page.

    Raises:
        UsageError: it has no episode.
        EnvCraftError: the sandbox failed.
    """
    try:
        conditions = Conditions.from_json(finding.repro.conditions)
        rollout = Rollout(finding.repro.seed, finding.repro.actions, conditions, player="the reproduction")
        recorded = _recorded(subject, rollout, finding.code, finding=number)
        again = None if check is None else check.confirm(subject, finding)
    except Skip as skip:
        raise UsageError(f"{finding.code} cannot be replayed: {skip}") from None
    except msgspec.ValidationError as error:
        raise UsageError(f"the reproduction of {finding.code} is invalid: {error}") from None
    words = "the check is not installed" if check is None else "not reproduced" if again is None else "reproduced"
    recorded.data["words"] = f"{words}: {recorded.data['words']}"
    return recorded


def _recorded(subject: Subject, rollout: Rollout, label: str, **more: Any) -> Recorded:
    conditions = with_frames(subject, rollout.conditions)
    keep = min(len(rollout.actions) + 1, FRAMES)
    # The cache would keep the trace with all its frames.
    trace = subject.rerun(msgspec.structs.replace(rollout, conditions=conditions, keep=keep))
    frames = shown(trace)
    data = episode(trace, frames, label, rate_of(subject), **more)
    return Recorded(data, tiles(frames) if frames else None)
