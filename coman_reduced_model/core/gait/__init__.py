# SPDX-License-Identifier: BSD-3-Clause
"""Plans of walks: gait, footsteps, LIPM, and the walk that follows a plan."""
