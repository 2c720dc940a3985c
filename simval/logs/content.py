"""The text of a log in any of three encodings; other kinds of file are refused."""

import unicodedata
from os import PathLike

from simval.errors import InputError
from simval.files import MOST_LOG, read_bytes

_KINDS = {  # first bytes: what the file is, and what to do
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
_PLAIN_CONTROLS = "\t\n\r\f\v\x1a"  # the last ends a file of DOS


def file_bytes(path: str | PathLike[str]) -> bytes:
    """Read a file whole.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        return read_bytes(path, MOST_LOG)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        why = getattr(error, "strerror", None) or error
        msg = f"cannot read {path}: {why}; give the path of a log"
        raise InputError(msg) from None


def is_matlab(path: str, content: bytes) -> bool:
    """Whether a file is MATLAB's: format 5 by its first bytes, format 4 by its name."""
    if content.startswith(b"MATLAB 5.0"):
        return True
    named = path.lower().endswith(".mat") and b"\0" in content[:20]
    return named and not content.startswith(tuple(_KINDS))


def decoded(path: str | PathLike[str], content: bytes) -> str:
    """Text in UTF-8, UTF-16 with its mark, or Windows-1252 (which holds Latin-1).

    Compatibility characters become plain ones (NFKC): a superscript 2 is a 2, and the
    two Greek mu are one.

    Raises
    ------
    InputError
        If the bytes are no text, with what they are and what to do.
    """
    for start, kind in _KINDS.items():
        if content.startswith(start):
            msg = f"{path} is not a text file but {kind}"
            raise InputError(msg)
    utf16 = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if utf16 else ("utf-8-sig", "cp1252"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if all(c in _PLAIN_CONTROLS or ord(c) >= 32 for c in set(text)):
            text = text.rstrip("\x1a")
            return text if text.isascii() else _plain(text)
    msg = f"{path} is not a text file; export the log as rows of numbers"
    raise InputError(msg)


def _plain(text: str) -> str:
    return unicodedata.normalize("NFKC", text).replace("\N{MINUS SIGN}", "-")
