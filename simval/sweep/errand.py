"""A batch on its way to a worker: bytes, and the code that unpacks them there.

A scheduler may hand a batch to a worker that has joined just now and has not yet been
asked what it is. What travels by its name makes a worker without that module break its
connection and end, and the driver would learn of a lost worker only.
"""

from collections.abc import Callable
from typing import Any

from simval.sweep.cells import Done
from simval.sweep.executors import Batch, computed
from simval.sweep.identity import StrangerError


def errand() -> Callable[[bytes, bytes], Any]:
    """What a worker does with a batch; it travels as code, as the roster's question.

    It looks at the batch only once the driver's statement has been met. A worker that
    differs answers with its address and why: lines, or the words of an error.
    """

    def compute(stated: bytes, batch: bytes) -> Any:
        import pickle

        from distributed import get_worker

        try:
            pickle.loads(stated).require()
        except Exception as error:
            words = f"{type(error).__name__}: {error}"
            return get_worker().address, getattr(error, "lines", words)
        from simval.sweep.errand import on_worker

        return on_worker(pickle.loads(batch))

    return compute


def on_worker(batch: Batch) -> list[Done]:
    """Compute on a worker; one that differs says which it is."""
    from distributed import get_worker

    try:
        return computed(batch)
    except StrangerError as error:
        raise StrangerError(error.lines, get_worker().address) from None
