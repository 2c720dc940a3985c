"""Suite files: what is accepted, and what each refusal says."""

import pytest

from simval.errors import InputError
from simval.poses import observability
from simval.studies import STUDIES
from simval.studies.calibration import simulated_rests
from simval.sweep import load_suite, suite_schema
from simval.vocabulary import builtin_suites


@pytest.fixture
def loaded(tmp_path):
    """The suite of a text, or of bytes."""

    def load(text, *more):
        path = tmp_path / "mine.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_suite(str(path), *more)

    return load


def test_every_builtin_suite_expands_to_cells_of_different_names():
    assert {"smoke", "accuracy"} <= set(builtin_suites())
    for name in builtin_suites():
        suite = load_suite(name)
        names = [cell.name for cell in suite.cells]
        assert len(set(names)) == len(names) > 0
        assert suite.title


def test_lists_are_axes_and_names_are_canonical(loaded):
    text = "seed = [1, 2]\n[attitude]\nnoise_std = [0.01, 0.02]\nsamples = 65536\n"
    expected = [
        f"attitude(geometry=3,noise_std={noise},samples=65536)@{seed}"
        for seed in (1, 2)
        for noise in (0.01, 0.02)
    ]
    for form in (text, b"\xef\xbb\xbf" + text.encode()):  # with a byte-order mark
        assert [cell.name for cell in loaded(form).cells] == expected


def test_the_command_line_wins(loaded):
    text = "seed = 4\n[attitude]\nnoise_std = [0.01, 0.02]\n"
    suite = loaded(text, ["attitude.noise_std=1e-3", "attitude.geometry=1,2"], 9)
    assert {cell.parameters.noise_std for cell in suite.cells} == {1e-3}
    assert [cell.parameters.geometry for cell in suite.cells] == [1, 2]
    assert {cell.seed for cell in suite.cells} == {9}
    suite = loaded(text, ["attitude.noise_std=[0.03, 0.04]"])
    assert [cell.parameters.noise_std for cell in suite.cells] == [0.03, 0.04]


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
        ("[attitude]\nnoise_std = [0.1, -0.1]\n", r"0.000000001 \(given -0.1\)"),
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
        (b"\xff\xfe\x00", "cannot be read"),
    ],
)
def test_refusals_name_the_key_and_what_is_allowed(loaded, text, words):
    with pytest.raises(InputError, match=words) as told:
        loaded(text)
    # of a number, its own half of the refusal; not that a list would do as well
    assert "list" not in str(told.value) or "[" in str(text)[12:]


@pytest.mark.parametrize(
    ("name", "overrides", "words"),
    [
        ("nightly", [], r"no suite `nightly`.*accuracy.*smoke"),
        ("x" * 300, [], "no suite"),
        ("smoke", ["attitude.noise_std=1\nx=2"], "noise_std"),
        *(
            ("smoke", [word], r"STUDY\.KEY=VALUE")
            for word in ("noise_std=1", "attitude.noise_std", "=", "a.b=", "a.b.c=1")
        ),
    ],
)
def test_names_and_overrides_that_are_none(name, overrides, words):
    with pytest.raises(InputError, match=words):
        load_suite(name, overrides)


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


def test_the_schema_lists_every_study_and_parameter():
    schema = suite_schema()
    assert {*STUDIES, "seed"} <= set(schema["properties"])
    for study in STUDIES.values():
        grid = schema["$defs"][f"{study.name}_grid"]["properties"]
        fields = study.parameters.model_fields
        assert grid.keys() == fields.keys()
        for name, field in fields.items():
            assert field.description in grid[name]["description"]


def test_a_quantity_with_its_unit_is_answered_by_the_unit_that_is_needed(loaded):
    asked = 0
    for study in STUDIES.values():
        for name, field in study.parameters.model_fields.items():
            if field.annotation not in (int, float):
                continue
            asked += 1
            with pytest.raises(InputError) as refusal:
                loaded(f"[{study.name}]\n{name} = ['5 mg', 1, '12']\n")
            words = str(refusal.value)
            assert f"`{study.name}.{name}`: Input should be a number" in words
            assert field.description.rstrip(".") in words
    assert asked > 70
