"""Speed and quality tables, run by hand: `python -m benchmarks.<name>`.

On one thread: BLAS reads so when numpy is first imported, which is after this.
"""

from __future__ import annotations

import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
