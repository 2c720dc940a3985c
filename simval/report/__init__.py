"""Pages as self-contained HTML: of a run, a comparison, or a log.

Computing and drawing are apart: a section reads the run and computes panels and
tables (arrays and words); `paint` and the templates draw them; nothing simulates.
What studies declare is drawn by `gallery`, `artifacts` and `declared`; a section that
is more than that has a function in `page.GROUPS`, which returns it, or None where the
run has nothing for it.
"""

from simval.report.calibration_page import render_calibration
from simval.report.comparison import render_comparison
from simval.report.page import drawings, render, tables
from simval.report.paint import png, svg_file
from simval.report.table import csv_text

__all__ = [
    "csv_text",
    "drawings",
    "png",
    "render",
    "render_calibration",
    "render_comparison",
    "svg_file",
    "tables",
]
