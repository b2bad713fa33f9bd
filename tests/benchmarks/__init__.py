"""Benchmarks, on one thread of the BLAS, as are the programs that they start.

Its other threads wait by spinning, and processor time counts that. It reads the variable when NumPy
is imported, which is after this.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
