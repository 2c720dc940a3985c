"""Recorded logs: rows of an accelerometer, read and checked once.

A row is one instant. Text is in UTF-8, UTF-16 or Latin-1, its fields are separated by
tabs, semicolons, commas or white space, its decimal mark is a point or a comma; words
above the header, and lines that start with ``#``, ``%`` or ``//``, are left aside. A
MATLAB file (format 4 or 5) is read by the names of its variables.

The header says which columns are taken (`simval.logs.names` says how); a header that
does not is a question to the user, never a guess. Without one the number of columns
tells: 3 are ``ax ay az``, 4 ``t ax ay az``, 6 ``ax ay az wx wy wz`` and 7 ``t`` and
those six.

Time becomes seconds by the unit that the header or the caller states
(`simval.logs.clock`). A log without a clock stands on the caller's rate alone: all that
is said in seconds is as right as that. The readings keep the unit of the file (raw
counts or SI), because a calibration absorbs it.

Every row must be there: a log with a hole, a repeated time or a value that is not a
number in a column that is taken is refused with the file and the line, never repaired.
"""

from simval.logs.columns import Column
from simval.logs.log import Log, read_log

__all__ = ["Column", "Log", "read_log"]
