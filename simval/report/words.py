"""Numbers for people: digits that mean something."""

import shlex


def number(value: float | None, digits: int = 6) -> str:
    """Spell a number for a person.

    Parameters
    ----------
    value : float or None
        The number.
    digits : int, default 6
        Significant digits.

    Returns
    -------
    str
        A dash for None.
    """
    return "–" if value is None else f"{value:.{digits}g}"  # noqa: RUF001


def measured(value: float, error: float) -> str:
    """Spell a value and its standard error with digits that mean something.

    Parameters
    ----------
    value, error : float
        The value and its standard error.

    Returns
    -------
    str
        Two digits of the error, the value to the same place.
    """
    if not error > 0.0 or not abs(value) < float("inf") or error == float("inf"):
        return number(value)
    exponent = int(f"{max(abs(value), error):e}".partition("e")[2])
    places = max(0, exponent - int(f"{error:e}".partition("e")[2]) + 1)
    scale = 10.0**exponent
    power = f"e{exponent}" if not -3 <= exponent <= 4 else ""
    if not power:
        scale, places = 1.0, max(0, places - exponent)
    return f"{value / scale:.{places}f} ± {error / scale:.{places}f}{power}"


def reproduce(cell: str) -> str:
    """Spell the command that computes one cell again.

    Parameters
    ----------
    cell : str
        Name of the cell.

    Returns
    -------
    str
        Quoted for a shell; empty for what is pooled over cells.
    """
    return f"simval repro {shlex.quote(cell)}" if "@" in cell else ""
