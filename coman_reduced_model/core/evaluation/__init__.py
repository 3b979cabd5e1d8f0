# SPDX-License-Identifier: BSD-3-Clause
"""How good predictions are: errors of runs and of horizons."""
