"""A log's file as a table: column names and numbers.

A reader is a module with two functions: ``sniff(path, content)`` returns whether a file
is of its kind, and ``read(path, content)`` its table (`ArrayTable` where the columns
are numbers already), or refuses it in words. A reader that stands in `READERS` serves
every command that reads a log.
"""

from typing import Final, Protocol

from simval.errors import InputError
from simval.files import MOST_LOG, read_bytes
from simval.imu.logs import matlab, text
from simval.imu.logs.tables import ArrayTable
from simval.imu.logs.text import TextTable

Table = ArrayTable | TextTable


class Reader(Protocol):
    """Reader of the files of one kind."""

    def sniff(self, path: str, content: bytes) -> bool:
        """Return whether a file is of this kind."""

    def read(self, path: str, content: bytes) -> Table:
        """Return its table."""


READERS: Final[tuple[Reader, ...]] = (matlab, text)
"""In the order in which they are asked; text takes what is left."""

UNREAD = {  # first bytes: what a file is that no reader takes, and what to do
    b"\x1f\x8b": "compressed by gzip; unpack it first (gunzip)",
    b"BZh": "compressed by bzip2; unpack it first (bunzip2)",
    b"\xfd7zXZ": "compressed by xz; unpack it first (unxz)",
    b"\x28\xb5\x2f\xfd": "compressed by zstd; unpack it first (unzstd)",
    b"7z\xbc\xaf": "a 7-zip archive; unpack it first",
    b"PK\x03\x04": "a zip archive or a spreadsheet (.xlsx); unpack or save it as CSV",
    b"\xd0\xcf\x11\xe0": "an old spreadsheet (.xls); save it as CSV",
    b"\x89HDF": "HDF5 (also MATLAB 7.3); save it as text, or in MATLAB with -v7",
    b"MATLAB 7.3": "a MATLAB 7.3 file; save it with -v7, or as text",
    b"PAR1": "a Parquet file; save it as CSV",
    b"SQLite format 3": "a SQLite database (a ROS 2 bag?); export the IMU topic as CSV",
    b"#ROSBAG": "a ROS bag; export the IMU topic as CSV (rostopic echo -p)",
    b"ULog": "a PX4 ULog; export it as CSV (ulog2csv)",
    b"\x93NUMPY": "a NumPy array; write it with numpy.savetxt",
    b"%PDF": "a PDF; export the log as rows of numbers",
}


def read_table(path: str) -> Table:
    """Read a file by the first reader that takes it.

    Raises
    ------
    InputError
        If it cannot be read, is of a kind without a reader, or has no rows of numbers.
    """
    try:
        content = read_bytes(path, MOST_LOG)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        why = getattr(error, "strerror", None) or error
        msg = f"cannot read {path}: {why}; give the path of a log"
        raise InputError(msg) from None
    for start, kind in UNREAD.items():
        if content.startswith(start):
            msg = f"{path} is not a text file but {kind}"
            raise InputError(msg)
    reader = next(each for each in READERS if each.sniff(path, content))
    return reader.read(path, content)
