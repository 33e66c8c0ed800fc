"""The certificates and statements of a result, computed again without the code that made them.

Nothing here knows the solvers: it rests on arrays, geometry and the files alone.
"""
