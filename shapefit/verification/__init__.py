"""The proofs in a result file, computed again in plain NumPy and without the solver's code.

Every number is compared within a bound on what rounding can do to it, see check.py. Nothing
here imports `convex` or `lifting`: a mistake there does not repeat itself here.
"""
