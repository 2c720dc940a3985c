"""MuJoCo's messages: collected, never printed, and never written to a log file."""

from collections.abc import Iterator
from contextlib import contextmanager

from simval.scene.library import mujoco


@contextmanager
def captured_messages() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings instead of letting it write a log file."""
    messages: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(messages.append)
    try:
        yield messages
    finally:
        mujoco.set_mju_user_warning(before)
