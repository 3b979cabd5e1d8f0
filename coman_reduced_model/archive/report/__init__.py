# SPDX-License-Identifier: BSD-3-Clause
"""What became of each robot: trends and changes by SQL and statistics, plots, one page."""
