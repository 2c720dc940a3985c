"""Run folders of an enemy: everything in one may be something else.

`attack` does one thing to a run folder, drawn at random. Some attacks are followed by a
new seal (`resealed`), as an enemy would who knows how one is made: it is no secret.
"""

import functools
import io
import json
import os
import pickle
import shutil
import socket
import zipfile
from dataclasses import dataclass

import numpy as np
from stores import _sign, raw

from simval.sweep.seal import seal
from simval.sweep.store import ROW_FIELDS

WORDS = (
    *("", "abc", "-1", "1e300", "x" * 100_000, "\x1b[31m\x07", "a\nb\x00c", "\u202e"),
    *("<script>alert(1)</script>", "{{ 7 * 7 }}", "../../etc/passwd", "%s%n", "NaN"),
)
NUMBERS = (
    *(1e300, -1e300, 1.7e308, 1e-200, -1e-200, 5e-324, -0.0, 0.0, 1e18),
    *(float("inf"), float("-inf"), None, 0, -1, 2**53, 2**62, 1, 1e-8),
)
NESTED = functools.reduce(lambda inner, _: [inner], range(900), [])
JSON_VALUES = (
    *(*WORDS, *NUMBERS, float("nan"), True, [], {}, [1], {"a": {}}, 10**400, 10**4200),
    *(["a"] * 9, {"": ""}, "\ud800", NESTED),
)


@dataclass(frozen=True)
class Attack:
    """What was done to a folder."""

    words: str
    signed: bool = False  # as the sweep itself would have sealed it
    lost: bool = False  # something is not there that the sweep has measured


def attack(folder, rng):
    """Do one thing to a run folder."""
    kinds = (
        *(
            _field,
            _field,
            _field,
            _cell,
            _parameters,
            _parameters,
            _manifest,
            _manifest,
        ),
        *(_times, _times, _schema, _schema, _entries, _entries, _kind, _kind, _kind),
        *(_array, _array, _pages, _stray),
    )
    return _pick(kinds, rng)(folder, rng)


def resealed(folder):
    """Sign the store and seal the files of a folder as they are now."""
    with raw(folder) as database:
        _sign(database)
        seal(database, folder)


def _pick(options, rng):
    return options[int(rng.integers(len(options)))]


def _field(folder, rng):
    name = _pick(ROW_FIELDS, rng)
    value = _pick((*WORDS, *NUMBERS, b"\x00\xff"), rng)
    with raw(folder) as database:
        (row,) = _pick(database.execute("SELECT rowid FROM rows").fetchall(), rng)
        query = f'UPDATE rows SET "{name}" = ? WHERE rowid = ?'
        database.execute(query, (value, row))
    return Attack(f"`{name}` of row {row} is {value!r:.40}", signed=rng.random() < 0.8)


def _cell(folder, rng):
    name = _pick(("cell", "study", "seed", "status", "error", "seconds"), rng)
    value = _pick((*WORDS, *NUMBERS, b"\x00\xff", "failed", "pending"), rng)
    with raw(folder) as database:
        query = (
            f"UPDATE OR IGNORE cells SET {name} = coalesce(?, 'x') WHERE position = 1"
        )
        database.execute(query, (value,))
    return Attack(f"`{name}` of cell 1 is {value!r:.40}", signed=rng.random() < 0.8)


def _parameters(folder, rng):
    with raw(folder) as database:
        query = "SELECT parameters FROM cells WHERE position = 1"
        content = json.loads(database.execute(query).fetchone()[0])
        words = _changed(content, rng)
        text = _pick(("{}", "[]", "null", ""), rng) if rng.random() < 0.2 else None
        query = "UPDATE cells SET parameters = ? WHERE position = 1"
        database.execute(query, (json.dumps(content) if text is None else text,))
    return Attack(f"parameters: {text} {words}", signed=rng.random() < 0.8)


def _manifest(folder, rng):
    with raw(folder) as database:
        query = "SELECT value FROM meta WHERE key = 'manifest'"
        content = json.loads(database.execute(query).fetchone()[0])
        words = _changed(content, rng)
        query = "UPDATE meta SET value = ? WHERE key = 'manifest'"
        database.execute(query, (json.dumps(content),))
    return Attack(f"manifest: {words}", signed=rng.random() < 0.8)


def _times(folder, rng):
    file = folder / "timing.json"
    content = json.loads(file.read_text())
    words = _changed(content, rng)
    file.write_text(json.dumps(content))
    return Attack(f"times: {words}", signed=rng.random() < 0.8)


def _changed(content, rng):
    """Change, take out or add one thing somewhere in a JSON object."""
    holder, path = content, []
    while True:
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        key = _pick(keys, rng)
        path.append(str(key))
        inner = holder[key]
        if not (isinstance(inner, dict | list) and inner) or rng.random() < 0.2:
            break
        holder = inner
    draw = rng.random()
    if draw < 0.2:
        del holder[key]
        return f"{'.'.join(path)} taken out"
    if draw < 0.3 and isinstance(holder, dict):
        key = _pick(WORDS[:4], rng)
    holder[key] = _pick(JSON_VALUES, rng)
    return f"{'.'.join(path)} is {holder[key]!r:.40}"


ENDLESS = (
    "WITH RECURSIVE x(n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM x) SELECT n AS {}"
)
FIELDS = ", ".join(f'n AS "{name}"' for name in ROW_FIELDS)
SCHEMAS = (
    "CREATE TABLE more (x)",
    "CREATE INDEX quick ON rows (value)",
    "CREATE VIEW more AS SELECT * FROM rows",
    "CREATE TRIGGER t AFTER UPDATE ON rows BEGIN DELETE FROM cells; END",
    "ALTER TABLE rows ADD COLUMN more",
    'ALTER TABLE rows RENAME COLUMN "n" TO "m"',
    "DROP TABLE meta",
    "DROP TABLE cells",
    "DROP TABLE rows",
    "ALTER TABLE rows RENAME TO old; CREATE VIEW rows AS "
    + ENDLESS.format(f"cell, n AS ordinal, {FIELDS} FROM x"),
    "ALTER TABLE cells RENAME TO old; CREATE VIEW cells AS "
    + ENDLESS.format(
        "position, '' AS cell, '' AS study, 1 AS seed, '{}' AS parameters, 'done' AS "
        "status, '' AS error, 0.0 AS seconds, '' AS digest FROM x"
    ),
    "ALTER TABLE meta RENAME TO old; CREATE VIEW meta AS "
    + ENDLESS.format("key, 'x' AS value FROM x WHERE n < 0"),
)


def _schema(folder, rng):
    sql = _pick(SCHEMAS, rng)
    with raw(folder) as database:
        database.executescript(sql)
    return Attack(sql[:60])


def _entries(folder, rng):
    """Take away, double or swap rows, or cells."""
    others = ", ".join(f'"{name}"' for name in ROW_FIELDS)
    signed = rng.random() < 0.8
    statements = (
        ("DELETE FROM rows WHERE cell = 1", True),
        ("DELETE FROM rows WHERE cell = 1 AND ordinal = 3", True),
        ("DELETE FROM cells WHERE position = 1", True),
        ("DELETE FROM rows; DELETE FROM cells", True),
        (
            "DELETE FROM rows WHERE cell = (SELECT max(position) FROM cells); "
            "DELETE FROM cells WHERE position = (SELECT max(position) FROM cells)",
            True,
        ),
        (
            "INSERT INTO rows SELECT cell, (SELECT count(*) FROM rows WHERE cell = 1), "
            f"{others} FROM rows WHERE cell = 1 AND ordinal = 2",
            False,
        ),
        (
            "UPDATE cells SET parameters = (SELECT parameters FROM cells WHERE "
            "position = 0) WHERE position = 1",
            True,
        ),
        (
            "UPDATE rows SET cell = 1 - cell + 1000 WHERE cell < 2; "
            "UPDATE rows SET cell = cell - 1000 WHERE cell > 900; "
            "UPDATE cells SET position = -1 WHERE position = 0; "
            "UPDATE cells SET position = 0 WHERE position = 1; "
            "UPDATE cells SET position = 1 WHERE position = -1",
            True,
        ),
        ("UPDATE rows SET rowid = -rowid", False),
    )
    sql, lost = _pick(statements, rng)
    with raw(folder) as database:
        database.executescript(sql)
    return Attack(sql[:60], signed=signed, lost=lost)


NAMES = (
    *("run.sqlite", "run.sqlite-wal", "run.sqlite-journal", "timing.json"),
    *("manifest.json", "results.csv", "artifacts", "artifacts/scene-die-12.npz"),
    *("artifacts/scene-die-12.png", "artifacts/convergence-x.npz", "results"),
)


def _kind(folder, rng):
    """Put something else in the place of a file."""
    name = _pick(NAMES, rng)
    kind = _pick(("pipe", "socket", "folder", "link", "dead", "empty", "huge"), rng)
    put(folder / name, kind)
    # a store is not signed through a pipe, nor a hundred gigabytes of nothing sealed
    can = "/" in name and kind in ("folder", "link", "dead", "empty")
    return Attack(f"{name} is {kind}", signed=can and rng.random() < 0.5)


def put(file, kind):
    """Something else in the place of a file or a folder."""
    if file.is_dir() and not file.is_symlink():
        shutil.rmtree(file)
    elif kind != "huge":
        file.unlink(missing_ok=True)
    link = "/etc" if file.suffix == "" else "/etc/passwd"
    {
        "pipe": lambda: os.mkfifo(file),
        "socket": lambda: _socket(file),
        "folder": file.mkdir,
        "link": lambda: file.symlink_to(link),
        "dead": lambda: file.symlink_to("nowhere"),
        "empty": file.touch,
        "huge": lambda: _huge(file),
    }[kind]()


def _socket(file):
    here = os.getcwd()
    os.chdir(file.parent)  # the path of a socket is short
    try:
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(file.name)
    finally:
        os.chdir(here)


def _huge(file):
    with file.open("ab") as content:
        content.truncate(100 * 2**30)  # of nothing: no disk is filled


@functools.cache
def bomb(megabytes=80):
    """A small zip file of an array that is large: zeros."""
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as members,
        members.open("directions.npy", "w") as member,
    ):
        shape = (megabytes * 2**17,)
        head = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, head)
        for _ in range(megabytes):
            member.write(bytes(2**20))
    return buffer.getvalue()


def header(shape, descr="<f8", data=b""):
    """An array by what its header says."""
    buffer = io.BytesIO()
    head = {"descr": descr, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, head)
    return buffer.getvalue() + data


class Runs:
    """What must never be made of a pickle."""

    def __reduce__(self):
        return os.abort, ()


def packed(data, name="directions.npy", how=zipfile.ZIP_STORED):
    """A zip file with one member."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", how) as members:
        members.writestr(name, data)
    return buffer.getvalue()


def arrays_of():
    """Files in the place of an npz file."""
    return (
        bomb(),
        packed(header((10**10,))),
        packed(header((10**6, 10**6, 10**6), "<f4")),
        packed(header((-1,))),
        packed(header((0, 3))),
        packed(header((1,), "|O", pickle.dumps([Runs()]))),
        packed(header((10**12,), "|V0")),
        packed(header((1, 3), data=np.full(3, np.nan).tobytes())),
        packed(header((1, 3), data=np.full(3, 1e308).tobytes())),
        packed(header((2, 3), data=np.full(6, 5e-324).tobytes())),
        packed(header((2, 3), data=bytes(48))),
        packed(header((1, 3), data=bytes(24)), how=zipfile.ZIP_LZMA),
        packed(header((1, 3), data=bytes(24)), name="../../x"),
        packed(b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 9000),
        pickle.dumps(Runs()),
        b"PK\x05\x06" + bytes(18),
        b"",
    )


def _array(folder, rng):
    name = _pick(("scene-die-12", "convergence-x", "static-gimbal-0"), rng)
    at = int(rng.integers(len(arrays_of())))
    (folder / "artifacts" / f"{name}.npz").write_bytes(arrays_of()[at])
    return Attack(f"{name}: {at}", signed=rng.random() < 0.8)


def _pages(folder, rng):
    """Bytes of the store turned, moved, or one page put over another."""
    file = folder / "run.sqlite"
    data = bytearray(file.read_bytes())
    pages = len(data) // 4096
    one, other = (int(page) for page in rng.integers(pages, size=2))
    if rng.random() < 0.5:
        data[one * 4096 : (one + 1) * 4096] = data[other * 4096 : (other + 1) * 4096]
    else:
        at = int(rng.integers(len(data) - 8))
        data[at : at + 8] = rng.integers(0, 256, 8, dtype=np.uint8).tobytes()
    file.write_bytes(data)
    return Attack(f"pages {one} and {other}")


def _stray(folder, rng):
    """A file that no sweep has written, or a picture that is none."""
    name = _pick(("scene-x-1.npz", "scene-x-1.png", "scene-die-12.png"), rng)
    (folder / "artifacts" / name).write_bytes(b"<svg onload=alert(1)>")
    return Attack(name, signed=rng.random() < 0.5)
