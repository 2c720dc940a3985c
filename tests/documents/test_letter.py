"""docs/letter.md: whoever reads it can check every statement by the lines it gives."""

import doctest

from places import ROOT


def test_every_check_of_the_letter_holds():
    text = (ROOT / "docs" / "letter.md").read_text("utf-8")
    test = doctest.DocTestParser().get_doctest(text, {}, "letter.md", None, 0)
    checks = [example for example in test.examples if "True" in example.want]
    assert len(checks) == 8
    assert doctest.DocTestRunner(verbose=False).run(test).failed == 0
