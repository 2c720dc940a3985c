"""Audit of simulated IMUs: what a simulator reads, and what an ideal sensor would.

`simulated`     readings beside poses, and what is declared
`terms`         what may be wrong of each sensor, as columns
`regression`    their products in bands of frequency, and the fewest that explain
`fewest`        one sensor, judged
`reckoning`     where the readings lead
`noise_claims`  noise as claimed, and axes that share a seed
`words`         what is wrong in words, and what would make that
`audit`         all of it
"""

from simval.imu.audit.audit import ALPHA, QUESTIONS, Audit, audit
from simval.imu.audit.simulated import Declared, SimulatedImu

__all__ = ["ALPHA", "QUESTIONS", "Audit", "Declared", "SimulatedImu", "audit"]
