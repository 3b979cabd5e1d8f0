# SPDX-License-Identifier: BSD-3-Clause
"""What the sensors say before any model: support phase, odometry, ZMP."""
