"""How fast a plan is: fgplan's solver beside its peers on the identical density, in one run.

It imports nothing, so that the threads are limited before numpy starts them.
"""

import os

for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
