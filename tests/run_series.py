"""A folder of runs: copies of one run, of several commits, changed on purpose."""

import json
import shutil

from stores import rewritten


def commit_of(number):
    """The made-up commit of a run."""
    return f"{number:02d}" + "abcdef0123456789" * 2 + "abcdef"


def add_run(folder, source, number, *statements, seed=None, committed=True, **manifest):
    """Copy a run as that of another commit, a day after the one before."""
    place = folder / f"run{number}"
    shutil.copytree(source, place)
    with rewritten(place) as database:
        (text,) = database.execute(
            "SELECT value FROM meta WHERE key = 'manifest'"
        ).fetchone()
        known = json.loads(text)
        known["git"] = {"commit": commit_of(number), "dirty": False}
        database.execute(
            "UPDATE meta SET value = ? WHERE key = 'manifest'",
            [json.dumps(known | manifest)],
        )
        for sql in statements:
            database.execute(sql)
    timing = json.loads((source / "timing.json").read_text())
    timing["started"] = f"2026-02-{28 - number:02d}T12:00:00+00:00"
    if committed:
        timing["committed"] = f"2026-01-{1 + number:02d}T12:00:00+01:00"
    else:
        timing.pop("committed", None)
    (place / "timing.json").write_text(json.dumps(timing))
    return place
