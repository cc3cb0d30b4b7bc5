"""Hard cases: inputs at which engines lose digits or return NaN, each with a stated limit on what may be lost.

Rotation, springs, fields, derivatives, distances of shapes, contact.
"""

from jaxrb.hard.case import Case, Measured, Verdict, judge, precision
from jaxrb.hard.table import CASES, cases_named

__all__ = ["CASES", "Case", "Measured", "Verdict", "cases_named", "judge", "precision"]
