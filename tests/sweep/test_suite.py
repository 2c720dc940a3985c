"""Suite files: what is accepted, and what each refusal says."""

import pytest

from simval.errors import InputError
from simval.poses import observability
from simval.studies import STUDIES
from simval.studies.calibration import simulated_rests
from simval.sweep import load_suite, suite_schema
from simval.vocabulary import builtin_suites


def written(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return str(path)


def test_builtin_suites_expand():
    assert {"smoke", "accuracy"} <= set(builtin_suites())
    for name in builtin_suites():
        suite = load_suite(name)
        names = [cell.name for cell in suite.cells]
        assert len(set(names)) == len(names) > 0
        assert suite.title


def test_lists_are_axes_and_names_are_canonical(tmp_path):
    text = "seed = [1, 2]\n[attitude]\nnoise_std = [0.01, 0.02]\nsamples = 65536\n"
    suite = load_suite(written(tmp_path, text))
    assert [cell.name for cell in suite.cells] == [
        f"attitude(geometry=3,noise_std={noise},samples=65536)@{seed}"
        for seed in (1, 2)
        for noise in (0.01, 0.02)
    ]


def test_the_command_line_wins(tmp_path):
    text = "seed = 4\n[attitude]\nnoise_std = [0.01, 0.02]\n"
    path = written(tmp_path, text)
    suite = load_suite(path, ["attitude.noise_std=1e-3", "attitude.geometry=1,2"], 9)
    assert {cell.parameters.noise_std for cell in suite.cells} == {1e-3}
    assert [cell.parameters.geometry for cell in suite.cells] == [1, 2]
    assert {cell.seed for cell in suite.cells} == {9}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[attitude]\nnoise = 1\n", "`attitude.noise` is not a known key.*noise_std"),
        ("[altitude]\nnoise_std = 1\n", "`altitude` is not a known key.*attitude"),
        ("[attitude]\nnoise_std = []\n", "`attitude.noise_std`.*at least 1 item"),
        (
            "[attitude]\nnoise_std = -0.1\n",
            "`attitude.noise_std`.*greater than or equal to 0.000000001",
        ),
        ("[attitude]\nnoise_std = [0.1, -0.1]\n", "`attitude.noise_std`"),
        ("[attitude]\nnoise_std = 'small'\n", "`attitude.noise_std`.*'small'"),
        ("[attitude]\nsamples = 100000.5\n", "`attitude.samples`.*integer"),
        ("[attitude]\nnoise_std = nan\n", "`attitude.noise_std`"),
        ("[calibration]\nscene = 'moon'\n", "`calibration.scene`.*'gimbal'"),
        ("[attitude]\nnoise_std = [0.1, 0.1]\n", "twice"),
        ("seed = -1\n[attitude]\n", "`seed`"),
        ("title = 'empty'\n", "names no study"),
        ("", "names no study"),
        ("[attitude\n", "not valid TOML"),
        ("attitude = 3\n", "`attitude`"),
    ],
)
def test_refusals_name_the_key_and_what_is_allowed(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        load_suite(written(tmp_path, text))


def test_an_unknown_suite_lists_the_known_ones():
    with pytest.raises(InputError, match=r"no suite `nightly`.*accuracy.*smoke"):
        load_suite("nightly")


def test_a_file_that_is_not_text_is_refused(tmp_path):
    path = tmp_path / "bytes.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        load_suite(str(path))


@pytest.mark.parametrize(
    "override", ["noise_std=1", "attitude.noise_std", "=", "a.b=", "a.b.c=1"]
)
def test_a_malformed_override_shows_the_form(override):
    with pytest.raises(InputError, match=r"STUDY\.KEY=VALUE"):
        load_suite("smoke", [override])


def test_only_the_meant_half_of_a_refusal_is_told(tmp_path):
    path = written(tmp_path, "[attitude]\nnoise_std = -0.1\n")
    with pytest.raises(InputError) as told:
        load_suite(path)
    assert "list" not in str(told.value)
    path = written(tmp_path, "[attitude]\nnoise_std = [0.1, -0.1]\n")
    with pytest.raises(InputError, match=r"equal to 0.000000001 \(given -0.1\)"):
        load_suite(path)


def test_lists_and_odd_words_on_the_command_line():
    words = ["attitude.noise_std=[0.01, 0.02]"]
    cells = [c for c in load_suite("smoke", words).cells if c.study == "attitude"]
    assert [c.parameters.noise_std for c in cells] == [0.01, 0.02]
    with pytest.raises(InputError, match="noise_std"):
        load_suite("smoke", ["attitude.noise_std=1\nx=2"])
    with pytest.raises(InputError, match="no suite"):
        load_suite("x" * 300)


def test_a_byte_order_mark_is_no_error(tmp_path):
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf[attitude]\n")
    assert len(load_suite(str(path)).cells) == 1


@pytest.mark.ci
def test_every_scene_of_the_builtin_suites_shows_enough_faces():
    wanted = {
        (cell.parameters.scene, cell.parameters.poses)
        for name in builtin_suites()
        for cell in load_suite(name).cells
        if cell.study in ("scene", "calibration")
    }
    for kind, poses in sorted(wanted):
        rests = simulated_rests(kind, poses, 0.2)
        found = observability(rests.forces.mean(axis=1) / rests.g)
        assert found.rank == 9, (kind, poses)


def test_the_schema_lists_every_parameter():
    schema = suite_schema()
    assert {"attitude", "calibration", "scene", "seed"} <= set(schema["properties"])
    grid = schema["$defs"]["attitude_grid"]["properties"]
    assert "noise_std" in grid
    assert "Noise" in grid["noise_std"]["description"]


def test_a_quantity_with_its_unit_is_answered_by_the_unit_that_is_needed(tmp_path):
    asked = 0
    for study in STUDIES.values():
        for name, field in study.parameters.model_fields.items():
            if field.annotation not in (int, float):
                continue
            for value in ("'0.01 m/s^2'", "['5 mg', 1]", "'12'"):
                path = written(tmp_path, f"[{study.name}]\n{name} = {value}\n")
                with pytest.raises(InputError) as refusal:
                    load_suite(path)
                words = str(refusal.value)
                assert f"`{study.name}.{name}`: Input should be a number" in words
                assert field.description.rstrip(".") in words
                asked += 1
    assert asked > 200
