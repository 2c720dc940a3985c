"""Damage to one field of a run folder, drawn at random, and whether it can be known.

`damage` changes one thing: a field of a cell or of one of its rows, an entry of the
manifest, of the times or of the table, an array of an artifact. It says what it did,
and whether what is there now can be at all: a number that is another one may be.
"""

import io
import json
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np
from stores import raw

from simval.statistics import FAMILIES
from simval.sweep.store import ROW_FIELDS

WORDS = ("abc", "", "1.5", b"\x00\xff", "9" * 400, "a/b.py", "-")
NUMBERS = (None, inf, -inf, 0, 0.0, -1.0, -1, 1e308, -1e308, 5e-324, 1e-300, 2**60)
VALUES = (*WORDS, *NUMBERS)
JSON_VALUES = (
    *("abc", "", None, inf, -inf, float("nan"), 0, 0.0, -1.0, -1, 1e308, 5e-324),
    *(10**400, [], {}, [1], {"a": 1}, True, "\ud800", "[" * 50),
)


@dataclass(frozen=True)
class Damage:
    """What was done."""

    words: str
    impossible: bool = False  # so it must not pass whatever the digests say


def damage(folder, rng):
    """Damage one thing in a run folder; None where nothing was changed."""
    kinds = (_row, _row, _row, _row, _cell, _cell, _parameter, _parameter, _rows)
    kinds += (_swap, _meta, _meta, _json_file, _table, _artifact)
    return kinds[rng.integers(len(kinds))](folder, rng)


def _pick(options, rng):
    return options[int(rng.integers(len(options)))]


def _row(folder, rng):
    with raw(folder) as database:
        entry = _pick(database.execute("SELECT rowid, * FROM rows").fetchall(), rng)
        names = ("rowid", "cell", "ordinal", *ROW_FIELDS)
        now = dict(zip(names, entry, strict=True))
        name = _pick(ROW_FIELDS, rng)
        value = _pick((*VALUES, _turned(now[name])), rng)
        database.execute(
            f'UPDATE rows SET "{name}" = ? WHERE rowid = ?', (value, now["rowid"])
        )
        words = f"{now['family']} `{name}`: {now[name]!r:.40} -> {value!r:.40}"
    return Damage(words, _impossible(now, name, value))


def _turned(value):
    if isinstance(value, int | float) and value:
        return -value
    return f"{value}x"


def _impossible(row, name, value):
    """Whether a judged number, or any of its type, cannot be what it is now."""
    number = isinstance(value, int | float)
    if name in ("family", "entries", "check"):
        return True  # none of the values is one
    if name in ("unit", "predictor"):
        return not isinstance(value, str)
    if name in ("n", "controlled"):
        most = 2**53 if name == "n" else 2
        return not (type(value) is int and 0 <= value < most)
    if value is None or (number and not isfinite(value)):
        return row["check"] != "record"  # not measured: reported, and never judged
    if not number:
        return True
    if name in ("standard_error", "remainder"):
        return value < 0
    family = FAMILIES[row["family"]]
    return not family.least <= value <= family.most


def _cell(folder, rng):
    name = _pick(
        ("cell", "study", "seed", "parameters", "status", "error", "seconds"), rng
    )
    with raw(folder) as database:
        place, old = _pick(
            database.execute(f"SELECT position, {name} FROM cells").fetchall(), rng
        )
        value = _pick(
            (*VALUES, "pending", "failed", "done", "scene", _turned(old)), rng
        )
        try:
            database.execute(
                f"UPDATE cells SET {name} = ? WHERE position = ?", (value, place)
            )
        except Exception:  # a constraint: the file was never changed
            return None
    told = name in ("cell", "study", "seed", "parameters")
    return Damage(f"cell {place} {name} -> {value!r:.40}", told and value != old)


def _parameter(folder, rng):
    with raw(folder) as database:
        place, text = _pick(
            database.execute("SELECT position, parameters FROM cells").fetchall(), rng
        )
        found = json.loads(text)
        new, words = _edited(found, rng)
        if rng.random() < 0.1:
            new, words = text[: rng.integers(len(text))], "cut off"
        database.execute(
            "UPDATE cells SET parameters = ? WHERE position = ?", (new, place)
        )
    return Damage(f"cell {place} parameters: {words}", new != text)


def _edited(content, rng):
    """JSON with one entry changed, taken out or added, and what was done."""
    holder, path = content, []
    while True:
        key = _pick(list(holder), rng)
        path.append(str(key))
        if not (isinstance(holder[key], dict) and holder[key]):
            break
        holder = holder[key]
    kind = rng.integers(8)
    if kind == 0:
        del holder[key]
        words = "taken out"
    elif kind == 1:
        holder[f"{key}x"] = 1
        words = "doubled"
    else:
        holder[key] = _pick(JSON_VALUES, rng)
        words = repr(holder[key])[:40]
    return json.dumps(content), f"{'.'.join(path)} {words}"


def _rows(folder, rng):
    with raw(folder) as database:
        rowid, cell = _pick(
            database.execute("SELECT rowid, cell FROM rows").fetchall(), rng
        )
        kind = int(rng.integers(5))
        where = f"WHERE rowid = {rowid}"
        database.execute(
            (
                f"DELETE FROM rows {where}",
                "INSERT INTO rows SELECT cell, ordinal + 1000, "
                + ", ".join(f'"{field}"' for field in ROW_FIELDS)
                + f" FROM rows {where}",
                f"UPDATE rows SET ordinal = 1000 {where}",
                f"UPDATE rows SET cell = 99, ordinal = 0 {where}",
                f"DELETE FROM cells WHERE position = {cell}",
            )[kind]
        )
    return Damage(f"rows of cell {cell}: {kind}", kind >= 2)


def _swap(folder, rng):
    column = _pick(("cell", "parameters", "study", "family"), rng)
    with raw(folder) as database:
        table = "rows" if column == "family" else "cells"
        query = f"SELECT rowid, {column} FROM {table}"
        entries = database.execute(query).fetchall()
        (a, old), (b, new) = _pick(entries, rng), _pick(entries, rng)
        if a == b or old == new:
            return None
        database.execute(f"UPDATE {table} SET {column} = '?' WHERE rowid = {a}")
        for place, value in ((b, old), (a, new)):
            database.execute(
                f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, place)
            )
    # two cells of one study may be alike in all but the name, which is what they are
    return Damage(f"{column} of {a} and {b} swapped", column in ("cell", "parameters"))


def _meta(folder, rng):
    with raw(folder) as database:
        entries = database.execute(
            "SELECT key, value FROM meta WHERE key != 'files'"
        ).fetchall()
        key, old = _pick(entries, rng)
        if key == "manifest":
            value, words = _edited(json.loads(old), rng)
            if rng.random() < 0.1:
                value, words = old[: rng.integers(len(old))], "cut off"
        else:
            value = words = _pick(("", "0", "abc", "3"), rng)
        database.execute("UPDATE meta SET value = ? WHERE key = ?", (value, key))
    return Damage(f"{key}: {words}")


def _json_file(folder, rng):
    file = folder / _pick(("timing.json", "manifest.json"), rng)
    text = file.read_text()
    new, words = _edited(json.loads(text), rng)
    if rng.random() < 0.2:
        new, words = text[: rng.integers(len(text))], "cut off"
    file.write_text(new)
    return Damage(f"{file.name}: {words}")


def _table(folder, rng):
    file = folder / "results.csv"
    lines = file.read_text().splitlines(keepends=True)
    place = int(rng.integers(len(lines)))
    fields = lines[place].split(",")
    fields[rng.integers(len(fields))] = str(_pick(NUMBERS, rng))
    lines[place] = ",".join(fields)
    file.write_text("".join(lines))
    return Damage(f"results.csv, line {place}")


def _artifact(folder, rng):
    files = sorted((folder / "artifacts").glob("*.npz"))
    if not files:
        return None
    file = _pick(files, rng)
    with np.load(file) as content:
        arrays = {name: content[name] for name in content.files}
    name = _pick(list(arrays), rng)
    odd = (
        np.array(1.0), np.empty(0), np.full(arrays[name].shape, np.nan),
        -np.abs(arrays[name]), np.full(arrays[name].shape, np.inf),
        arrays[name].ravel()[:-1], np.zeros((2, 3, 4)), np.array(["a"]),
        np.array([1e308, -1e308]), arrays[name][:1],
    )  # fmt: skip
    choice = int(rng.integers(len(odd) + 2))
    if choice == len(odd):
        del arrays[name]
    elif choice < len(odd):
        arrays[name] = odd[choice]
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    data = buffer.getvalue()
    file.write_bytes(data[: len(data) // 2] if choice == len(odd) + 1 else data)
    return Damage(f"{file.name}, {name}: {choice}")
