"""Shapes in annotations: `Float[Array, "n 3"]` is an array of n rows of 3 floats.

They are `jaxtyping`'s for a type checker and in the tests, which import it first and
check them; in a user's run they stand for the array and cost no import.
"""

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Inexact, Int, Shaped
else:

    class Float:
        """An array; its shape is checked only in the tests."""

        def __class_getitem__(cls, of: tuple[Any, str]) -> Any:
            """Return the type of the array, and ignore the shape."""
            return of[0]

    Bool = Inexact = Int = Shaped = Float

__all__ = ["Bool", "Float", "Inexact", "Int", "Shaped"]
