# SPDX-License-Identifier: BSD-3-Clause
"""Online prediction of the centre of mass of a compliant humanoid."""

__version__ = "0.1.0"
