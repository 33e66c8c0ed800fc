"""Tests; each process has one thread of linear algebra, as several processes share the
cores.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded
