"""The runner of pages: what it takes for the same, and what it does not."""

import pytest
from walkthrough import Walk, blocks, same

PAGE = """\
# A page

```python title="two.py"
print(1 + 1)
```

## Run

```console
$ python two.py
2
$ python -c "import sys; print(0.125); \\
> sys.exit(3)"
0.125
$ echo $?
3
```

```python
raise SystemExit("a block without a title is not run")
```
"""


def walked(text, folder):
    page = folder / "page.md"
    page.write_text(text)
    walk = Walk(page, folder)
    walk.to("Run")
    return walk


def test_a_page_that_is_right(tmp_path):
    assert walked(PAGE, tmp_path).wrong == []
    assert [block.section for block in blocks(PAGE)] == ["", "Run"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("\n0.125\n", "\n0.127\n", "page.md:"),
        ("\n2\n", "\n2\n2\n", "page.md:"),
        ("$ echo $?\n3\n", "", "ended with 3"),
    ],
)
def test_a_page_that_is_wrong_is_found(tmp_path, old, new, said):
    (message,) = walked(PAGE.replace(old, new), tmp_path).wrong
    assert said in message


@pytest.mark.parametrize(
    ("shown", "printed", "equal"),
    [
        ("a  1.25 b", "a 1.26   b", True),  # the last digit may round otherwise
        ("1.2e-05", "1.4e-05", False),
        ("125", "126", False),
        ("-8e-17", "3.1e-16", True),  # both are rounding
        ("−0.5 m", "0.5 m", False),
        ("1 passed in 0.23s", "1 passed in 12.80s", True),  # how long it took
        ("1 passed in 0.23s", "2 passed in 0.23s", False),
    ],
)
def test_the_rule(shown, printed, equal):
    assert same((shown,), [printed]) is equal
