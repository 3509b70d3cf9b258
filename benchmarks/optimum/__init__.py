"""How good a plan is: the energy chosen by `fgplan.plan` beside the best that is known.

It imports nothing, so that the threads are limited before numpy starts them.
"""

import os

for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
