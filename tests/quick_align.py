"""The example plug-in align.py for all rows at once: SciPy's takes one by one."""

ALIGN = """
import numpy as np
from simval.imu.attitude.comparators import davenport
from simval.geometry import conjugate
from simval.plugins import Estimator

def _align(*vectors):
    return conjugate(davenport(*vectors))

align = Estimator(name="align", estimate=_align, components="xyzs", matrix="active")
"""
