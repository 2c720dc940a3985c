"""Shapes in annotations: `Float[Array, "n 3"]` is an array of floats of that shape.

They are `jaxtyping`'s for a type checker and in the tests, which import it first and
check them; in a user's run they stand for the array and cost no import.
"""

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Float, Inexact, Int, Shaped
else:

    class Float:
        """Any array."""

        def __class_getitem__(cls, of: tuple[Any, str]) -> Any:
            """Give back the type of the array."""
            return of[0]

    Bool = Inexact = Int = Shaped = Float

__all__ = ["Bool", "Float", "Inexact", "Int", "Shaped"]
