"""A process between ours and a plug-in's that ends all that the plug-in leaves.

A process that forks twice, or opens a session of its own, leaves its group and is
nobody's child. Linux gives such orphans to the nearest ancestor that asks for them, a
subreaper: here the first of two processes, which forks the one that runs the plug-in.
When that has ended, when it is told to (SIGTERM), or when its own parent is gone, the
first kills its children, those that are handed to it too, until it has none, and ends
as the plug-in did. Elsewhere there is one process, and its group is all that is ended.
"""

import ctypes
import os
import resource
import signal
import sys
from contextlib import suppress
from time import monotonic
from typing import Final

PR_SET_PDEATHSIG: Final = 1
PR_SET_CHILD_SUBREAPER: Final = 36

GLANCE: Final = 1.0
"""Seconds after which it looks by itself whether its parent is still there."""

ENDING: Final = 5.0
"""Seconds after which it gives up killing what is left."""

PAUSE: Final = 0.01
"""Seconds between two rounds of killing, in which killed processes go."""

TOLD: Final = frozenset({signal.SIGCHLD, signal.SIGTERM, signal.SIGINT, signal.SIGHUP})


def supervised(connection: int = -1) -> None:
    """Divide this process in two, and return in the one that is to run the plug-in.

    The connection is the plug-in's alone.
    """
    if sys.platform != "linux" or not control(PR_SET_CHILD_SUBREAPER, 1):
        return
    above, here = os.getppid(), os.getpid()
    control(PR_SET_PDEATHSIG, signal.SIGTERM)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TOLD)
    plugin = os.fork()
    if not plugin:
        control(PR_SET_PDEATHSIG, signal.SIGKILL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if os.getppid() != here:
            os._exit(1)
        return
    if connection >= 0:
        os.close(connection)
    status = _followed(plugin, above)
    _end_all()
    _end_as(status)


def control(option: int, value: int) -> bool:
    """Ask the Linux kernel for something about this process, see prctl(2)."""
    try:
        return bool(ctypes.CDLL(None).prctl(option, value, 0, 0, 0) == 0)
    except (OSError, AttributeError):
        return False


def _followed(plugin: int, above: int) -> int:
    """Wait for the plug-in's process and reap others; how it ended, or was to end."""
    while True:
        heard = signal.sigtimedwait(TOLD, GLANCE)
        if (heard and heard.si_signo != signal.SIGCHLD) or os.getppid() != above:
            return int(signal.SIGKILL)
        with suppress(ChildProcessError):
            while (found := os.waitpid(-1, os.WNOHANG))[0]:
                if found[0] == plugin:
                    return found[1]


def _end_all() -> None:
    """Kill the children, and theirs as they are handed over, until there are none."""
    here, own, end = os.getpid(), os.getpgrp(), monotonic() + ENDING
    with suppress(ChildProcessError):
        while monotonic() < end:  # what runs as another user cannot be killed
            for process in _descendants(here):
                with suppress(ProcessLookupError, PermissionError):
                    os.kill(process, signal.SIGKILL)
                    if (group := os.getpgid(process)) != own:
                        os.killpg(group, signal.SIGKILL)
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
            signal.sigtimedwait({signal.SIGCHLD}, PAUSE)


def _descendants(ancestor: int) -> list[int]:
    """Children of a process, their children and so on, as the system lists them now."""
    parents = {}
    for name in os.listdir("/proc"):
        if name.isdigit():
            with suppress(OSError), open(f"/proc/{name}/stat", "rb") as file:
                parents[int(name)] = int(file.read().rpartition(b")")[2].split()[1])
    found, new = [], [ancestor]
    while new:
        new = [each for each, parent in parents.items() if parent in new]
        found += new
    return found


def _end_as(status: int) -> None:
    """End as another process did, by the same signal or exit code, without a dump."""
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with suppress(OSError, ValueError):  # of SIGKILL nothing can be set
            signal.signal(-code, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, set())
        os.kill(os.getpid(), -code)
    os._exit(code if code >= 0 else 128 - code)
