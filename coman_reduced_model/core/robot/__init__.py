# SPDX-License-Identifier: BSD-3-Clause
"""The robot: kinematics of a URDF with two legs."""
