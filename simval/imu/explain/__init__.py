"""Judgement of the rests of a sensor: whether something is wrong, and what.

    `explanation`   what may be wrong, as data: its sentence, its remedy
    `catalogue`     what is tried on a log
    `likelihood`    how well an explanation fits, at any rank
    `judgement`     the one comparison, and what it says

It takes plain arrays, of any sensor that reads a vector of constant length at rest.
"""

from simval.imu.explain.explanation import Explanation, Remedy, RestMeans
from simval.imu.explain.judgement import Finding, Judgement, judge

__all__ = ["Explanation", "Finding", "Judgement", "Remedy", "RestMeans", "judge"]
