"""In a notebook: what completion, help, tables and figures say, and the tutorial."""

import json
import re

import matplotlib as mpl
import numpy as np
import pytest
import walkthrough
from places import ROOT

import simval
from docs.site.notebook import executed
from simval.errors import InputError
from simval.imu.calibrate.accelerometer import calibrate
from simval.imu.sensor import forms
from simval.poses import fibonacci_sphere
from simval.sweep import load_run

NOTEBOOKS = sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))


@pytest.fixture(autouse=True)
def _no_window():
    from matplotlib import pyplot

    with mpl.rc_context({"backend": "agg"}):
        yield
    pyplot.close("all")


def fitted(model="triangular", trials=()):
    rng = np.random.default_rng(3)
    noise = 0.01 * rng.standard_normal((*trials, 24, 3))
    return calibrate(9.80665 * fibonacci_sphere(24) + noise, model=model)


@pytest.mark.parametrize("model", forms.MODELS)
def test_what_is_printed_and_what_stands_in_the_parameters_is_told_apart(model):
    fit = fitted(model)
    shown = {**_entries(fit)}
    for place, name in enumerate(fit.names):
        entry = forms.entries(model)[place][0]
        if shown[entry] != fit.parameters[place]:
            note = f"parameters[{place}], {name}, is -{entry}"
            assert shown[entry] == -fit.parameters[place]
            assert note in str(fit)
            assert note in fit._repr_html_()
    assert ("is -" in str(fit)) == (model == "triangular")


def _entries(fit):
    """The entries by name, from the attributes that a user reads."""
    if fit.model == "symmetric":
        upper = fit.K[np.triu_indices(3)]
        return dict(zip(fit.names, [*upper, *fit.B], strict=True))
    off = {f"T[{i}][{j}]": fit.T[i, j] for i in range(3) for j in range(3)}
    names = ("K_x", "K_y", "K_z", "B_x", "B_y", "B_z")
    return off | dict(zip(names, [*fit.K, *fit.B], strict=True))


@pytest.mark.parametrize("trials", [(), (8,)])
@pytest.mark.parametrize("model", forms.MODELS)
def test_a_fit_draws_what_it_printed(model, trials):
    from matplotlib.axes import Axes

    fit = fitted(model, trials)
    panels = fit.plot()
    assert all(isinstance(panel, Axes) for panel in panels)
    drawn, names = [], []
    for panel in panels:
        drawn += list(panel.lines[0].get_ydata())
        names += [label.get_text() for label in panel.get_xticklabels()]
    signs = [sign for _, sign in forms.entries(model)]
    expected = np.atleast_2d(fit.parameters).mean(axis=0) * signs
    np.testing.assert_allclose(drawn, expected, rtol=1e-12)  # a mean of eight
    assert names == [name for name, _ in forms.entries(model)]
    assert fit.plot(panels) is panels
    with pytest.raises(InputError, match=r"`axes` has 1 panels"):
        fit.plot(panels[:1])


def drawn(panels):
    """What stands in the panels, and the halves of its bars."""
    values, halves = [], []
    for panel in panels:
        (bars,) = panel.containers
        values += list(bars.lines[0].get_ydata())
        low, high = np.array([s[:, 1] for s in bars.lines[2][0].get_segments()]).T
        halves += list((high - low) / 2.0)
    return np.array(values), np.array(halves)


@pytest.mark.parametrize("model", forms.MODELS)
def test_pulls_are_errors_in_standard_deviations(model):
    fit = fitted(model)
    truth = simval.AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
    signs = np.array([sign for _, sign in forms.entries(model)])
    values, halves = drawn(fit.plot(reference=truth))
    own = (
        np.eye(3)[np.triu_indices(3)]
        if model == "symmetric"
        else np.r_[0, 0, 0, 1, 1, 1]
    )
    expected = signs * (fit.parameters - np.r_[own, np.zeros(3)]) / fit.sd
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    np.testing.assert_allclose(halves, 1.96)
    by_values, _ = drawn(fit.plot(reference=np.r_[own, np.zeros(3)]))
    np.testing.assert_allclose(by_values, expected, rtol=1e-12)
    # of another fit the deviation is that of the difference
    other = calibrate(9.80665 * fibonacci_sphere(24) + 1e-3 * np.ones(3), model=model,
                      noise_std=0.02)  # fmt: skip
    values, _ = drawn(fit.plot(reference=other))
    size = np.sqrt(fit.sd**2 + other.sd**2)
    expected = signs * (fit.parameters - other.parameters) / size
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    for wrong in (np.zeros(3), fitted(forms.MODELS[forms.MODELS.index(model) - 1])):
        with pytest.raises(InputError, match=r"order of `fit\.parameters`"):
            fit.plot(reference=wrong)


def test_pulls_of_trials_are_their_mean_and_spread():
    batch = fitted(trials=(8,))
    zero = np.r_[0, 0, 0, 1, 1, 1, 0, 0, 0]
    values, halves = drawn(batch.plot(reference=zero))
    pulls = (batch.parameters - zero) / batch.sd
    signs = [sign for _, sign in forms.entries("triangular")]
    np.testing.assert_allclose(values, signs * pulls.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(halves, 1.96 * pulls.std(axis=0, ddof=1), rtol=1e-12)


def test_a_run_is_short_in_words_and_drawn_on_demand(tiny_run):
    run = load_run(tiny_run)
    assert len(repr(run)) < 120 + len(str(tiny_run))
    assert "<td>calibration</td><td>2 done</td>" in run._repr_html_()
    axes = run.plot("bias[x]")
    assert axes.get_xlabel() == "noise_std"
    rows = {
        cell.parameters["noise_std"]: row.value
        for cell in run.of("attitude")
        for row in reversed(cell.rows)
        if str(row.statistic) == "bias[x]"
    }
    points = axes.containers[0].lines[0]
    assert dict(zip(points.get_xdata(), points.get_ydata(), strict=True)) == rows
    assert len(rows) == 2
    assert run.plot("rms[K]", axes=axes) is axes
    with pytest.raises(InputError, match=r"did you mean `rms\[K\]`"):
        run.plot("rms[k]")
    with pytest.raises(InputError, match=r"has the parameter `nois`.*`noise_std`"):
        run.plot("rms[K]", along="nois")


@pytest.mark.ci
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebook_shows_what_its_cells_show(path, tmp_path):
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    now = executed(content, tmp_path)
    shown, printed = (
        [each for cell in nb["cells"] for each in cell.get("outputs", [])]
        for nb in (content, now)
    )
    assert sum("text/html" in each["data"] for each in shown) >= 2
    for one, other in zip(shown, printed, strict=True):
        assert walkthrough.same(*map(_lines, (one, other)))


def _lines(output):
    """Lines and elements; of a picture, which is of the machine, that it is there."""
    return [
        line
        for kind, text in output["data"].items()
        for line in [kind, *re.split("\n|(?<=>)", "".join(text)) * (kind[0] == "t")]
    ]
