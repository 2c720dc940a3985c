"""Enters every claim, source by source, in the order of the text."""

from errata import (  # noqa: F401
    errors,
    estimator,
    gaussian,
    moments,
    singular,
    symmetric,
    tables,
    triangular,
    turns,
)  # isort: skip
