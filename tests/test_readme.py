"""The README's Python example runs, and gives what it says."""

import re

from places import ROOT


def test_the_example_runs(capsys):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    scope = {}
    exec(compile(example, "README.md", "exec"), scope)
    out = capsys.readouterr().out
    assert "best possible" in out
    # the example's readings are within 5 standard deviations of the truth
    error = scope["fit"].parameters - scope["model"].parameters
    assert (abs(error) < 5 * scope["fit"].sd).all()
    assert scope["fit"].status == "converged"


def test_the_suite_example_is_valid(tmp_path):
    from simval.sweep import load_suite

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (suite,) = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    path = tmp_path / "poses.toml"
    path.write_text(suite)
    assert len(load_suite(str(path)).cells) == 6
