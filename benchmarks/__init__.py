"""Measurements: claims of speed and accuracy, each printed by one command. Not part of the installed package."""

import os

# As onboard: a matrix of a window is too small to share among threads, and with other work on the machine it takes
# several times as long. Before NumPy is imported, or it counts for nothing.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
