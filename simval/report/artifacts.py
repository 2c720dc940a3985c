"""Files that the studies left for the report, read without trusting them."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.errors import InputError


def arrays(file: Path) -> Mapping[str, Array]:
    """Read the arrays of an npz file; no pickle is ever loaded.

    Parameters
    ----------
    file : Path
        In the folder ``artifacts`` of a run.

    Returns
    -------
    mapping
        Name to array.

    Raises
    ------
    InputError
        If the file cannot be read as arrays of numbers.
    """
    try:
        with np.load(file, allow_pickle=False) as content:
            found = {name: np.asarray(content[name]) for name in content.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        msg = f"{file} is damaged ({error}); run the suite again"
        raise InputError(msg) from None
    for name, values in found.items():
        if values.dtype.kind not in "biuf":
            msg = f"{file}: `{name}` is no array of numbers; run the suite again"
            raise InputError(msg)
    return found
