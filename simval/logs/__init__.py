"""Recorded logs: text files of accelerometer rows, read and checked once.

A row is one instant. Columns are separated by white space, commas or semicolons; a
header line and lines that start with ``#`` or ``%`` are allowed. Without names the
number of columns tells what they are: 3 are ``ax ay az``, 4 ``t ax ay az``, 6
``ax ay az wx wy wz`` and 7 ``t`` and those six. Time is in seconds; the readings keep
the unit of the file (raw counts or SI), because a calibration absorbs it.

Every row must be there: a log with a hole, a repeated time or a value that is not a
number is refused with the file and the line, never repaired.
"""

from simval.logs.log import Log, read_log

__all__ = ["Log", "read_log"]
