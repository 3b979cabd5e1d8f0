# SPDX-License-Identifier: BSD-3-Clause
"""A recording under examination: signals, masks, landings, and the robot it is of."""
