# SPDX-License-Identifier: BSD-3-Clause
"""The command line `coman`: one file a command, what they share in common.py."""

import os

# Before numpy is loaded. Matrices are small here: threads of OpenBLAS would mostly wait for one another, and on cores
# that something else uses as well, for long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
