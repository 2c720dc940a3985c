"""Logs as text: the one writer of all tests."""

import numpy as np


def written(path, header, *columns, mark=",", form="{!r}"):
    """Write columns, (n,) or (n, k), below a header that may be empty; all digits."""
    rows = np.column_stack(columns).tolist()
    lines = [mark.join(form.format(x) for x in row) for row in rows]
    path.write_text("\n".join([*([header] if header else []), *lines, ""]))
    return path
