"""Benchmarks. Each prints tables and, with `--json FILE`, writes the same numbers.

All run on one core: the sizes of the thread pools are set before numpy is loaded.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
