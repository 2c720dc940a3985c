"""A message between two processes: words as JSON, and arrays of numbers as they are.

A message is the length of its head, the head, and the bytes of its arrays one after the
other. The head says what the arrays are called and their shapes; an entry is a float64.
So nothing that is read is unpickled or run, no message can make its reader wait for or
keep more than it allows, and every number crosses to the bit.
"""

import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import prod
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from simval.arrays import Array

LENGTH: Final = struct.Struct(">Q")

MOST_WORDS: Final = 1 << 20
"""Bytes of a head."""

MOST_NUMBERS: Final = 1 << 28
"""Bytes of all arrays of an answer: 2^20 exact cases answered by matrices are a
quarter of it."""

MOST_AXES: Final = 8

Size = Annotated[int, Field(ge=0, lt=1 << 48)]


class _Head(BaseModel):
    """What a message says before its arrays."""

    model_config = ConfigDict(strict=True, extra="forbid")

    words: dict[str, Any]
    shapes: dict[str, Annotated[list[Size], Field(max_length=MOST_AXES)]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Message:
    """Words and arrays, either by name."""

    words: Mapping[str, Any]
    arrays: Mapping[str, Array] = field(default_factory=dict)

    def parts(self) -> list[memoryview]:
        """The message as it crosses, in parts."""
        shapes = {name: list(np.shape(a)) for name, a in self.arrays.items()}
        head = json.dumps({"words": dict(self.words), "shapes": shapes}).encode()
        arrays = [np.ravel(np.asarray(a, np.float64)) for a in self.arrays.values()]
        numbers = [a.view(np.uint8).data for a in arrays if a.size]
        return [memoryview(LENGTH.pack(len(head)) + head), *numbers]


def received(read: Callable[[int], bytearray], most: float = MOST_NUMBERS) -> Message:
    """Read a message by a function that gives the next so many bytes.

    There may be so many bytes of numbers.

    Raises
    ------
    ValueError
        If what comes is no message, or greater than one may be.
    """
    (length,) = LENGTH.unpack(read(LENGTH.size))
    if length > MOST_WORDS:
        msg = f"a head of {length} bytes; at most {MOST_WORDS} are read"
        raise ValueError(msg)
    head = _Head.model_validate_json(read(length))
    sizes = {name: 8 * prod(shape) for name, shape in head.shapes.items()}
    if sum(sizes.values()) > most:
        msg = f"{sum(sizes.values())} bytes of numbers; at most {most} are read"
        raise ValueError(msg)
    arrays = {
        name: np.frombuffer(read(sizes[name])).reshape(shape)
        for name, shape in head.shapes.items()
    }
    return Message(words=head.words, arrays=arrays)
