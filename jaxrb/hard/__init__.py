"""Hard cases: inputs at which engines lose digits or return NaN, each with a stated limit on what may be lost.

What today's engine can run: rotation, springs, fields, derivatives, distances of shapes. Contact forces do not exist
yet, so no case rests, slides or stacks.
"""

from jaxrb.hard.case import Case, Measured, Verdict, judge, precision
from jaxrb.hard.table import CASES, cases_named

__all__ = ["CASES", "Case", "Measured", "Verdict", "cases_named", "judge", "precision"]
