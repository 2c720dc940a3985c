"""The report: complete, self-contained, the same bytes, honest about gaps."""

import csv
import html
import json
import re
import shlex
from dataclasses import replace
from decimal import Decimal
from math import inf
from xml.etree import ElementTree

import pytest
from places import ROOT
from read_back import svg
from snapshots import same
from stores import edited, edited_run

from simval.judge import judge_run
from simval.report import drawings, render, tables
from simval.report.page import sections
from simval.report.record import command, suite_text
from simval.report.section import folder_of, located
from simval.sweep import load_run, load_suite


@pytest.fixture(scope="module")
def page(_tiny_run):
    """The report of a clean run."""
    return render(load_run(_tiny_run))


def with_cells(run, change):
    """The run with each cell changed; a store would not hold such cells."""
    return replace(run, cells=tuple(map(change, run.cells)))


def test_figures_are_drawn_whatever_the_numbers(tiny_run):
    """Values that are infinite, huge, none, zero or negative, all in one run."""

    def odd(number, row):
        changes = {}
        if number % 5 < 3:
            kinds = ("value", inf), ("value", -row.value), ("standard_error", 0.0)
            changes = dict([kinds[number % 5]])
        if number % 7 == 3:
            changes["prediction"] = None
        if number % 11 == 4:
            changes["standard_error"] = inf
        if number % 13 == 5:  # an axis that ends here overflows
            changes["value"] = changes["standard_error"] = 1.7e308
        return replace(row, **changes)

    run = with_cells(
        load_run(tiny_run),
        lambda cell: replace(
            cell, rows=tuple(odd(i, row) for i, row in enumerate(cell.rows))
        ),
    )
    for figure in re.findall(r"<svg.*?</svg>", render(run), flags=re.DOTALL):
        ElementTree.fromstring(figure)


def test_the_same_run_gives_the_same_bytes(tiny_run, page):
    assert render(load_run(tiny_run)) == page


def test_the_page_stands_alone(tiny_run, page):
    """No address is loaded, no anchor leads nowhere, nothing of the day or the host."""
    links = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert links
    assert all(link.startswith(("data:", "#")) for link in links)
    assert "@import" not in page
    assert page.count("<script") == 1  # named by its hash
    assert "default-src 'none'" in page
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(set(ids)) == len(ids)
    targets = re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', page)
    assert {"".join(target) for target in targets} <= set(ids)
    timing = json.loads((tiny_run / "timing.json").read_text())
    day = timing["started"][:10]
    strange = [day, str(tiny_run.parent), *[timing["host"]] * (len(timing["host"]) > 4)]
    assert [word for word in strange if word in page] == []


def words_of(page):
    """Words of a page above its provenance, line by line, any number as `#`."""
    page = page.partition('<section id="provenance"')[0].partition("<main>")[2]
    page = re.sub(r"<(svg|tbody).*?</\1>", "", page, flags=re.DOTALL)
    lines = re.sub(r"<[^>]*>", " ", page).splitlines()
    told = (" ".join(html.unescape(line).split()) for line in lines)
    return [re.sub(r"\d[\d.,]*(e[+-]?\d+)?", "#", line) for line in told if line]


@pytest.mark.ci
def test_the_words_of_the_smoke_page(smoke_run):
    """The difference is for a reader."""
    found = "\n".join(words_of(render(load_run(smoke_run)))) + "\n"
    same("smoke_page.txt", found)


def test_figures_are_well_formed_have_a_text_and_keep_their_style(page):
    figures = re.findall(r"<svg xmlns.*?</svg>\n", page, flags=re.DOTALL)
    assert len(figures) >= 6
    for figure in figures:
        root = ElementTree.fromstring(figure)
        assert root.get("aria-label")
        # one image, and beside it, if any, its points with their titles
        image = root if root.get("role") == "img" else root[0]
        assert image.get("role") == "img"
        assert image.get("aria-label")
        assert all(p[0].text for p in root.iter("{http://www.w3.org/2000/svg}circle"))
        name = root.get("id")
        for style in root.iter("{http://www.w3.org/2000/svg}style"):
            assert style.text.startswith(f"#{name} ")  # reaches this figure only


CRASHED = "UPDATE cells SET status = 'failed', error = '<b>x</b>'"
WORSE = {
    # what is done to the run, the verdict on the page, what else it says
    "fewer samples": (
        ("UPDATE rows SET n = 4000 WHERE cell > 1 AND n > 0",),
        *("INCONCLUSIVE", "What was not measured"),
    ),
    "no number": (
        ("UPDATE rows SET value = 9e999 WHERE ordinal = 3",),
        *("INCONCLUSIVE", "inconclusive"),
    ),
    "crashed": ((CRASHED, "DELETE FROM rows"), *("FAIL", "&lt;b&gt;x&lt;/b&gt;")),
    "empty": (
        ("DELETE FROM rows", "UPDATE cells SET status = 'pending'"),
        *("INCONCLUSIVE", "What was not measured"),
    ),
    "off together": (  # a pooled check needs no cell
        (
            "UPDATE rows SET value = value * 1.5 "
            "WHERE family = 'nees' AND controlled = 0 AND entries = json_array()",
        ),
        *("FAIL", "nees, pooled"),
    ),
    "without a cell": (
        (
            "DELETE FROM rows WHERE cell = 2",
            "UPDATE cells SET status = 'pending' WHERE position = 2",
        ),
        *("INCONCLUSIVE", "What was not measured"),
    ),
}


@pytest.mark.parametrize("what", WORSE)
def test_the_page_says_what_the_gate_says(tiny_run, what):
    statements, answer, words = WORSE[what]
    run = edited_run(tiny_run, *statements)
    assert judge_run(run).answer == answer.lower()
    page = render(run)
    assert f'<span class="mark {answer.lower()}">{answer}</span>' in page
    assert words in page
    assert "<b>x</b>" not in page
    assert ("<svg" in page) == (what not in ("empty", "crashed"))


def test_a_failing_check_comes_first_with_its_figure(tiny_run):
    run = edited_run(
        tiny_run,
        "UPDATE rows SET value = value + 20 * standard_error "
        "WHERE family = 'bias' AND controlled = 0 "
        "AND entries = json_array('x') AND cell = 3",
    )
    page = render(run)
    assert '<span class="mark fail">FAIL</span>' in page
    assert '<section id="disagreements"' in page
    table = next(t for t in tables(run) if t.name == "verdicts")
    kinds = [row[0] for row in table.rows]
    failing = kinds.count("fail")
    assert failing >= 2  # against the exact theory and against the orders
    assert kinds[:failing] == ["fail"] * failing
    titles = [column.title for column in table.columns]
    first = dict(zip(titles, table.rows[0], strict=True))
    assert first["statistic"] == "bias[x]"
    # on the first screen stands the one that is farthest beyond what is allowed
    (short,) = (t for t in tables(run) if t.name == "failing")
    assert len(short.rows) == len({row[2:4] for row in table.rows[:failing]})
    assert re.search(r'verdict">.*?FAIL</span> <span>Attitude: ', page)
    assert f'id="figure-{first["figure"]}"' in page
    name = first["command"]
    assert name == f"simval repro --run tiny '{run.cells[3].name}'"


@pytest.mark.ci
def test_figures_and_tables_as_files(simval, tiny_run, tmp_path):
    run, figures = load_run(tiny_run), tmp_path / "f"
    words = ("report", tiny_run, "--figures", figures, "--only")
    code, _, err = simval(*words, "nothing")
    assert code == 2
    assert "there is no figure `nothing`; there are summary-calibration" in err
    code, out, _ = simval(*words, "closeness", "--tables", tmp_path / "t")
    assert code == 0
    assert out.splitlines()[-1] == str(tiny_run / "report.html")
    assert {p.name for p in figures.iterdir()} == {"closeness.png", "closeness.svg"}
    picture = (figures / "closeness.svg").read_text(encoding="utf-8")
    assert ElementTree.fromstring(picture).get("aria-label")
    assert (figures / "closeness.png").read_bytes().startswith(b"\x89PNG")
    assert {p.stem for p in (tmp_path / "t").iterdir()} == {t.name for t in tables(run)}
    for table in tables(run):
        with (tmp_path / "t" / f"{table.name}.csv").open(encoding="utf-8") as file:
            lines = list(csv.reader(file))
        assert len(lines) == 1 + len(table.rows)
        assert len({len(line) for line in lines}) == 1


@pytest.mark.ci
def test_what_cannot_be_read_or_written_is_an_error(simval, tiny_run, tmp_path):
    assert simval("report", tmp_path)[0] == 2
    assert simval("report", tmp_path / "absent")[0] == 2
    assert simval("report", tiny_run, "--out", tmp_path / "no" / "x.html")[0] == 2
    (tmp_path / "file").write_text("")
    assert simval("report", tiny_run, "--figures", tmp_path / "file")[0] == 2
    artifacts = tiny_run / "artifacts"
    artifacts.mkdir(exist_ok=True)
    (artifacts / "scene-x-1.npz").write_bytes(b"PK no archive")
    code, _, err = simval("report", tiny_run)
    assert code == 2
    assert "scene-x-1.npz has changed since the sweep wrote it" in err
    edited(tiny_run)  # without a seal
    code, _, err = simval("report", tiny_run)
    assert code == 2
    assert "scene-x-1.npz is damaged" in err


def test_provenance_names_all_that_the_numbers_depend_on(tiny_run, page):
    section = page.partition('<section id="provenance"')[2]
    manifest = load_run(tiny_run).manifest
    wanted = [*manifest["versions"].values(), *manifest["models"].values()]
    wanted += [manifest["source"], manifest["git"]["commit"] or "not from a checkout"]
    wanted += [manifest["machine"]["system"], "s of processor time", "Seed"]
    for word in wanted:
        assert word in section


@pytest.mark.parametrize(
    ("overrides", "seed", "words"),
    [
        ((), None, ""),
        ((), 7, " --seed 7"),
        (
            *(("attitude.noise_std=0.001,0.02",), None),
            " --set attitude.noise_std=0.001,0.02",
        ),
    ],
)
def test_provenance_names_the_command_that_makes_the_run_again(
    tmp_path, overrides, seed, words
):
    suite = load_suite("smoke", overrides=overrides, seed=seed)
    manifest = {"suite": suite.name, "title": suite.title, "grid": suite.grid}
    assert command(manifest) == f"simval sweep smoke{words}"
    path = tmp_path / "suite.toml"
    path.write_text(suite_text(manifest), encoding="utf-8")
    again = load_suite(str(path))  # of one's own: by its file
    assert [c.name for c in again.cells] == [c.name for c in suite.cells]
    manifest = {"suite": again.name, "title": again.title, "grid": again.grid}
    assert command(manifest) == "simval sweep suite.toml"


def renamed(study):
    """Statements that give one study another name, in the suite too."""
    return (
        f"UPDATE cells SET cell = replace(cell, study || '(', '{study}('), "
        f"study = '{study}' WHERE position > 1",
        "UPDATE meta SET value = "
        f"replace(value, '\"attitude\": {{', '\"{study}\": {{') WHERE key = 'manifest'",
    )


@pytest.mark.ci
def test_a_study_without_a_section_is_shown_all_the_same(tiny_run):
    run = edited_run(tiny_run, *renamed("of_a_plugin"))
    (drawing,) = (d for d in drawings(run) if d.name == "study-of-a-plugin")
    ElementTree.fromstring(f"<all>{svg(drawing)}</all>")
    page = render(run)
    assert '<section id="other"' in page
    assert "<h4>of_a_plugin</h4>" in page
    assert 'id="figure-study-of-a-plugin"' in page


def test_names_from_data_cannot_leave_the_folder(simval, tiny_run, tmp_path):
    edited_run(tiny_run, *renamed("../../x y"))
    assert simval("report", tiny_run, "--tables", tmp_path / "a" / "t")[0] == 0
    assert (tmp_path / "a" / "t" / "study-x-y.csv").is_file()
    assert sorted(p.name for p in tmp_path.iterdir() if p.name != "tiny") == ["a"]


def test_the_sample_can_be_made_again():
    """Its suite is valid, its page names the suite, its figures are of the page."""
    suite = load_suite(str(ROOT / "reports" / "sample.toml"))
    page = (ROOT / "reports" / "sample.html").read_text(encoding="utf-8")
    assert {"sample suite", f"{len(suite.cells)} cells"} <= {*re.split("[<>]", page)}
    assert "with uncommitted changes" not in page
    for name in ("orders", "summary-attitude", "summary-calibration", "budget"):
        figure = (ROOT / "reports" / "figures" / f"{name}.svg").read_text("utf-8")
        # the page has a picture for each panel, the file all in one: the same words
        # and the same values of points
        told = re.findall(r"<(?:title|text)\b[^>]*>([^<]+)<", figure)
        assert len(told) > 10
        assert [words for words in told if f">{words}<" not in page] == []


NUMBER = re.compile(r"[-−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def numbers_of(page):
    """Numbers of a page by the words of their row, sorted: ties may change places.

    Each with a unit of its last digit, if it is no whole number.
    """
    found = {}
    for _, row in re.findall(r"<(tr|title|text)\b[^>]*>(.*?)</\1>", page, re.DOTALL):
        text = re.sub(r"<[^>]*>", " ", row)
        words = NUMBER.sub("#", text)
        for place, number in enumerate(NUMBER.findall(text)):
            given = Decimal(number.replace("−", "-"))
            unit = 10.0 ** min(int(given.as_tuple().exponent), 0) % 1.0
            found.setdefault((words, place), []).append((float(given), unit))
    return {key: sorted(each) for key, each in found.items()}


def differing(old, new):
    """Numbers of which rounding is not the cause.

    Over the kernels of five other processors a number of the sample above 1e-7 was off
    by up to 7.4e-4 of itself, and one below it by up to 5.0e-9: a third and a sixth of
    what is allowed here.
    """
    assert old.keys() == new.keys()
    return [
        (words, a, b)
        for (words, place), numbers in old.items()
        for (a, *unit), (b, *other) in zip(numbers, new[words, place], strict=True)
        if not abs(a - b) <= 3e-8 + max(2e-3 * abs(a), 1.1 * max(unit + other))
    ]


@pytest.mark.slow
def test_the_sample_is_of_today_s_code(simval, tmp_path, monkeypatch):
    """Made anew by `make sample` when this fails: a number is not as today's."""
    monkeypatch.chdir(tmp_path)
    folder = "reports/runs/sample"  # as the commands on the page have it
    assert simval("sweep", ROOT / "reports" / "sample.toml", "--out", folder)[0] == 0
    assert simval("report", folder, "--out", "page.html")[0] == 0
    made, committed = (
        path.read_text("utf-8")
        for path in (tmp_path / "page.html", ROOT / "reports" / "sample.html")
    )
    numbers = numbers_of(committed)
    assert sum(map(len, numbers.values())) > 5000
    assert differing(numbers, numbers_of(made)) == []
    # the test can fail: a hundredth more in any one of many rows
    places = list(re.finditer(r">0\.([5-9]\d{3,})<", made))[::5]
    for place in places:
        more = f">{1.01 * float(place[0][1:-1]):.6g}<"
        off = numbers_of(f"{made[: place.start()]}{more}{made[place.end() :]}")
        assert differing(numbers, off), place[0]
    assert len(places) > 10


@pytest.mark.ci
def test_every_note_of_a_run_names_a_cell_of_it(tiny_run, simval, monkeypatch):
    monkeypatch.chdir(tiny_run.parent)
    run = load_run(tiny_run)
    assert {c.run for c in run.cells} == {""}
    assert {c.run for c in located(run).cells} == {folder_of(run)} == {"tiny"}
    names = {c.name for c in run.cells}
    notes = [
        text
        for section in sections(run)
        for drawing in section.drawings
        for panel in drawing.panels
        for series in getattr(panel, "series", ())
        for text in series.notes
    ]
    assert len(notes) > 20
    for text in notes:
        program, verb, option, folder, name = shlex.split(text.splitlines()[-1])
        assert [program, verb, option, folder] == ["simval", "repro", "--run", "tiny"]
        assert name in names


def test_the_checks_name_noise_poses_and_what_else_varies(tiny_run):
    run = load_run(tiny_run)
    table = next(t for t in tables(run) if t.name == "verdicts")
    titles = [column.title for column in table.columns]
    cells = {c.name: c for c in run.cells}
    seen = set()
    for row in table.rows:
        said = dict(zip(titles, row, strict=True))
        if said["command"] is None:  # a study's cells together
            assert "all cells" in said["what else varies"]
            continue
        here = cells[shlex.split(said["command"])[-1]]
        seen.add(here.name)
        assert said["study"] == here.study.replace("_", " ")
        assert said["noise"] == here.parameters.get("noise_std")
        assert said["poses"] == here.parameters.get("poses")
    assert seen == set(cells)
