"""Ctrl-C and SIGTERM: raised and also recorded, so that neither is lost.

Where Python cannot raise it (a callback of a weak reference, `__del__`) a
`KeyboardInterrupt` is dropped, and an extension module that is interrupted while it is
imported makes it an `ImportError`.
"""

import signal
from types import FrameType


class Interruption:
    """Handler of a signal that remembers having been called."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Remember the call, and raise KeyboardInterrupt."""
        self.asked = True
        raise KeyboardInterrupt

    def heed(self) -> None:
        """Raise KeyboardInterrupt again, in case somebody swallowed the first one."""
        if self.asked:
            raise KeyboardInterrupt


def watch() -> Interruption:
    """Install the handler, but not for a Ctrl-C that the shell has made ignored."""
    handler = Interruption()
    # a polite end, as by a batch system, is an interruption like Ctrl-C
    signal.signal(signal.SIGTERM, handler)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, handler)
    return handler


def heed() -> None:
    """Raise KeyboardInterrupt if a signal came and its exception was swallowed."""
    handler = signal.getsignal(signal.SIGTERM)
    if isinstance(handler, Interruption):
        handler.heed()
