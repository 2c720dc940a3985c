"""Enters every claim, source by source, in the order of the text."""

from errata import (  # noqa: F401
    triangular,
    symmetric,
    estimator,
    singular,
    turns,
    errors,
    moments,
    gaussian,
    tables,
)  # isort: skip
