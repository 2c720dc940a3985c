"""What a colour, a marker and a line mean, the same on the whole page.

What was simulated or measured is blue, or of the cool colours beside it where several
groups share axes, each with a marker of its own. Predictions are lines: theory red, the
second order ochre, the source's fourth order pink, the complete fourth order green, the
exact answer in the ink of the words, the Cramér-Rao bound grey and dotted.

Every colour has a contrast of at least 3 to the paper, white and dark, and is told
apart with every kind of colour vision, or by its marker or line
(tests/report/test_report_figures.py).
"""

GROUPS = ("#0077bb", "#008877", "#6644ff", "#2277ee", "#885588", "#cc22bb")
"""What was measured, by group: residuals, numbers of poses, algorithms, axes x y z."""

MARKERS = ("o", "s", "^", "D", "v", "P")
"""Of each group: not told apart by colour alone."""

SIMULATED = GROUPS[0]
THEORY = "#cc0022"
ORDER_2 = "#bb8800"
ORDER_4_SOURCE = "#ee3388"
ORDER_4_COMPLETE = "#118844"
ORDER_2_PRINTED = "#776666"  # equation (63) as the source prints it
INK = "#010203"
"""The colour of the words: it becomes ``currentColor``, so it is dark or light."""
EXACT = INK
GREY = "#8c8c8c"
BOUND = GREY
SHARE = "#d55e00"
"""Of a map of shares that fail, more or less opaque."""
