"""Logs: a user's file with rows of sensor readings, read and checked once.

A row is one instant. Text is in UTF-8, UTF-16 or Latin-1, its fields are separated by
tabs, semicolons, commas, bars or white space, its decimal mark is a point or a comma;
words above the header, and lines that start with ``#``, ``%`` or ``//``, are ignored.
Other files, folders and archives are those of `simval.imu.logs.readers`.

The header says which columns are taken (by the rules of `simval.imu.logs.names`); where
it does not, the user is asked, and nothing is guessed. Without a header the number of
columns decides: 3 are ``ax ay az``, 4 ``t ax ay az``, 6 ``ax ay az wx wy wz`` and 7
``t`` and those six, where of six only the first three can be gravity. A magnetometer's
are taken by their names alone, ``mx my mz``. A temperature
(`simval.imu.logs.temperature`) becomes degrees Celsius.

An empty field is a cell without a reading: each sensor is read in its own rows, and
these are joined by `simval.imu.logs.joining`. A column without any number is none.

Time becomes seconds by the unit that the header or the caller states
(`simval.imu.logs.clock`). A log without a clock relies on the rate that its file or the
caller states: everything in seconds is as right as that. The readings keep the unit of
the file (raw counts or SI), because a calibration absorbs it.

Rows may be missing where a clock says when: what needs each row takes a part of the log
or refuses it. Of a longer hole than 5 s the time does not count for the rate. A log
with a repeated time, or a value that is not finite in a row where the sensor has a
reading, is refused with its line. A part of it may be read alone
(`simval.imu.logs.parts`). What is
mended is said: padding, a first or last line that is cut off, a row that stands twice,
a header that stands again where the clock goes on, midnight, and a counter of 16 or 32
bits that begins again. Recorded attitudes (`simval.imu.logs.truth`) may be missing in
any row.
"""

from simval.imu.logs.columns import Column
from simval.imu.logs.log import Log, read_log
from simval.imu.logs.rows import Rows
from simval.imu.logs.truth import Truth, read_positions, read_topic, read_truth

__all__ = [
    "Column",
    "Log",
    "Rows",
    "Truth",
    "read_log",
    "read_positions",
    "read_topic",
    "read_truth",
]
