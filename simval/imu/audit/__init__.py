"""Audit of simulated IMUs: their readings compared with an ideal sensor's.

`simulated`     readings beside poses, and what is declared
`pieces`        parts whose truth is smooth
`terms`         what may be wrong: a table, with its words
`ideal`         ideal readings, and the columns of what may be wrong
`regression`    the fewest that explain, by bands of frequency
`fewest`        one sensor, judged
`reckoning`     where the readings lead
`noise_claims`  noise as claimed, and axes that share a seed
`audit`         all of it
"""

from simval.imu.audit.audit import ALPHA, QUESTIONS, Audit, audit
from simval.imu.audit.simulated import Declared, SimulatedImu

__all__ = ["ALPHA", "QUESTIONS", "Audit", "Declared", "SimulatedImu", "audit"]
