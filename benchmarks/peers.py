"""The results of Gymnasium's and stable-baselines3's ``check_env`` on a file, in a forked child with a deadline."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import json
import multiprocessing
import sys
import warnings
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

PEERS = ("gymnasium", "stable-baselines3")
_SECONDS = 15.0


def complaints(paths: Sequence[Path]) -> dict[str, dict[str, str]]:
    """The complaint of each peer about each file, "" for none. Raises ImportError without stable-baselines3."""
    # Imported before the fork: each child would import them again.
    for module in ("gymnasium.utils.env_checker", "stable_baselines3.common.env_checker"):
        importlib.import_module(module)

    context = multiprocessing.get_context("fork")
    found: dict[str, dict[str, str]] = {}
    for path in paths:
        found[str(path)] = {}
        for peer in PEERS:
            ours, theirs = context.Pipe(duplex=False)
            child = context.Process(target=_check, args=(peer, path, theirs), daemon=True)
            child.start()
            theirs.close()
            complaint = f"no result within {_SECONDS:.0f} s"
            if ours.poll(_SECONDS):
                try:
                    complaint = str(ours.recv_bytes().decode())
                except EOFError:
                    complaint = "the process died"
            child.kill()
            child.join()
            found[str(path)][peer] = complaint
    return found


def _check(peer: str, path: Path, answer: Connection) -> None:
    sys.stdout = sys.stderr = open("/dev/null", "w")  # noqa: SIM115
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        try:
            _run(peer, path)
            complaint = "; ".join(str(warning.message) for warning in raised if _matters(str(warning.message)))
        except BaseException as error:
            complaint = f"{type(error).__name__}: {error}"
    answer.send_bytes(complaint.encode("utf-8", "replace"))
    answer.close()


def _run(peer: str, path: Path) -> None:
    import gymnasium

    spec = importlib.util.spec_from_file_location("peer_subject", path)
    if spec is None or spec.loader is None:
        raise ImportError(path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["peer_subject"] = module
    spec.loader.exec_module(module)
    kinds: list[Any] = [
        kind
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, gymnasium.Env) and kind.__module__ == "peer_subject" and not inspect.isabstract(kind)
    ]
    if not kinds:
        raise LookupError("no environment class")
    kind = kinds[-1]
    keywords = {"render_mode": "rgb_array"} if "render_mode" in inspect.signature(kind).parameters else {}
    env = kind(**keywords)
    if peer == "gymnasium":
        from gymnasium.utils.env_checker import check_env

        check_env(env)
    else:
        from stable_baselines3.common.env_checker import check_env as sb3_check_env

        sb3_check_env(env)


def _matters(message: str) -> bool:
    """Ignore the warnings that any environment gets that ``gymnasium.make`` did not make."""
    return not any(
        words in message for words in ("not having a spec", "spec is None", "`check_env(", "unwrapped version")
    )


if __name__ == "__main__":
    print(json.dumps(complaints([Path(name) for name in sys.argv[1:]]), indent=2))
