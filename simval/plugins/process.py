"""Processes that run code of a user's: a group of their own, which ends with them."""

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping
from typing import IO


def run_group(
    words: list[str],
    output: int | IO[bytes],
    time_limit: float,
    environment: Mapping[str, str] | None = None,
) -> int:
    """Run a program in a process group of its own, and end the whole group with it.

    Raises
    ------
    subprocess.TimeoutExpired
        If it did not end in time; it is gone then too.
    """
    child = subprocess.Popen(
        words,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT,
        env=environment,
        start_new_session=True,
    )
    try:
        return child.wait(timeout=time_limit)
    finally:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()


def ending(code: int) -> str:
    """Say how a process ended."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"was killed by {name} ({signal.strsignal(-code) or 'unknown'})"
