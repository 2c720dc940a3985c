"""Notebooks of the tutorials: run without Jupyter, and shown on the site.

``python -m docs.site.notebook`` runs them and writes into them what their cells show.
"""

import ast
import base64
import contextlib
import io
import json
import tempfile
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "tutorials"


def executed(content: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a notebook with what its cells show when they are run in a folder."""
    names: dict[str, Any] = {}
    cells, count = [], 0
    with contextlib.chdir(folder):
        for cell in content["cells"]:
            if cell["cell_type"] == "code":
                count += 1
                outputs = _run("".join(cell["source"]), names)
                cell = cell | {"execution_count": count, "outputs": outputs}
            cells.append(cell)
    return content | {"cells": cells}


def _run(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """Run a cell: the value of its last line, and its figures."""
    from matplotlib import pyplot

    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    shown = []
    exec(compile(tree, "cell", "exec"), names)
    if isinstance(last, ast.Expr):
        value = eval(ast.unparse(last.value), names)
        if not source.endswith(";"):
            shown.append(_output(_data(value)))
    for number in pyplot.get_fignums():
        file = io.BytesIO()
        figure = pyplot.figure(number)
        figure.savefig(file, format="png", dpi=80, bbox_inches="tight")
        image = base64.b64encode(file.getvalue()).decode()
        shown.append(_output({"image/png": [image], "text/plain": ["a figure"]}))
        pyplot.close(figure)
    return shown


def _output(data: dict[str, list[str]]) -> dict[str, Any]:
    return {"output_type": "display_data", "metadata": {}, "data": data}


def _data(value: object) -> dict[str, list[str]]:
    if not hasattr(value, "_repr_html_"):
        return {"text/plain": repr(value).splitlines(keepends=True)}
    plain = str(value).splitlines(keepends=True)
    return {"text/html": [value._repr_html_()], "text/plain": plain}


def markdown(text: str) -> str:
    """Return a notebook as a page of the site: its cells, each with what it shows."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output["data"]
            if "image/png" in data:
                image = f"data:image/png;base64,{data['image/png'][0]}"
                html = f'<img alt="The figure of the cell above" src="{image}">'
            elif "text/html" in data:
                html = "".join(data["text/html"])
            else:
                parts.append(f"```text\n{''.join(data['text/plain'])}\n```")
                continue
            parts.append(f'<div class="shown">{html}</div>')
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Run every notebook, and write what it shows into it."""
    import matplotlib as mpl

    mpl.use("agg")
    for path in sorted(FOLDER.glob("*.ipynb")):
        with tempfile.TemporaryDirectory() as folder:
            content = executed(json.loads(path.read_text("utf-8")), Path(folder))
        text = json.dumps(content, indent=1, ensure_ascii=False)
        path.write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
