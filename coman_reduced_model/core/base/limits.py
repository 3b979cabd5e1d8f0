# SPDX-License-Identifier: BSD-3-Clause
"""From where on a free run is beyond physics: it has diverged."""

DIVERGED = 0.5  # [m] from the measured COM
TOPPLED = 1.0  # [rad] that the trunk leans more or less than the measured one
