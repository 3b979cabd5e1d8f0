# SPDX-License-Identifier: BSD-3-Clause
"""Equations of motion: point mass (the paper), pendulum, and the trunk on its legs."""
