"""Random streams: an independent generator for each block of a cell's work.

A stream is fixed by the run's seed, the cell's canonical name and the number of
the block, and by nothing else: not by the cell's place in the grid, nor by the
worker that computes it. Adding a value to a sweep leaves every other number alone.
Block sizes are part of the promise, so each study keeps its own as a constant.
"""

import hashlib
from dataclasses import dataclass

import numpy as np

from simval.arguments import whole_number


def cell_key(name: str) -> tuple[int, ...]:
    """Key of a cell: the SHA-256 of its name, as eight 32-bit words."""
    digest = hashlib.sha256(name.encode()).digest()
    return tuple(int.from_bytes(digest[i : i + 4], "big") for i in range(0, 32, 4))


def sequence(seed: int, key: tuple[int, ...], block: int) -> np.random.SeedSequence:
    """Seed sequence of one block of one cell."""
    seed, block = whole_number("seed", seed, 0), whole_number("block", block, 0)
    return np.random.SeedSequence(seed, spawn_key=(*key, block))


def stream(seed: int, key: tuple[int, ...], block: int) -> np.random.Generator:
    """Generator of one block of one cell."""
    return np.random.Generator(np.random.SFC64(sequence(seed, key, block)))


@dataclass(frozen=True, slots=True)
class Streams:
    """The random streams of one cell: an independent generator for each block of work.

    A study gets it as an argument, draws only from it, and so gives the same numbers
    whichever process computes the cell, and whatever other cells a run has.

    Attributes
    ----------
    seed : int
        Seed of the run, 0 or more.
    key : tuple of int
        Key of the cell, made of its name by `cell_key`.
    """

    seed: int
    key: tuple[int, ...]

    def sequence(self, number: int) -> np.random.SeedSequence:
        """Seed sequence of one block, for other kinds of generator."""
        return sequence(self.seed, self.key, number)

    def block(self, number: int) -> np.random.Generator:
        """Generator of one block, fresh at each call."""
        return np.random.Generator(np.random.SFC64(self.sequence(number)))
