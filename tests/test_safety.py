"""Words that look like HTML, of a plug-in or a parameter, are shown as text."""

import json

import pytest
from stores import rewritten

HOSTILE = "<script>alert(1)</script>\"'>&<img src=x onerror=y>"
PLAIN = (
    "<img src=x onerror=y>"  # without a slash, which makes a value the name of a file
)


@pytest.mark.ci
def test_html_escapes_what_comes_from_data_and_plugins(tiny_run, tmp_path, simval):
    with rewritten(tiny_run) as db:
        for table, column, where in (
            ("rows", "entries", "cell = 0 AND ordinal = 0"),
            ("rows", "predictor", "cell = 1 AND ordinal = 2"),
            ("rows", "unit", "cell = 1 AND ordinal = 3"),
            ("cells", "error", "position = 2"),
        ):
            value = json.dumps([HOSTILE]) if column == "entries" else HOSTILE
            db.execute(f"UPDATE {table} SET {column} = ? WHERE {where}", (value,))
        db.execute("UPDATE cells SET status = 'failed' WHERE position = 2")
        values = (PLAIN, f"{PLAIN}!")
        for position, value in enumerate(values, start=2):
            db.execute(
                "UPDATE cells SET cell = 'hostile(x=' || ? || ')@1', "
                "study = 'hostile', parameters = ? WHERE position = ?",
                (value, json.dumps({"x": value}), position),
            )
        (manifest,) = db.execute(
            "SELECT value FROM meta WHERE key = 'manifest'"
        ).fetchone()
        content = json.loads(manifest) | {"suite": HOSTILE, "title": HOSTILE}
        del content["grid"]["attitude"]
        content["grid"]["hostile"] = {"x": values}
        db.execute(
            "UPDATE meta SET value = ? WHERE key = 'manifest'", (json.dumps(content),)
        )
    page = tmp_path / "report.html"
    assert simval("report", tiny_run, "--out", page)[0] == 0
    text = page.read_text()
    assert "alert(1)" in text  # it is there, as text
    assert "<script>alert" not in text
    assert "<img src=x" not in text
