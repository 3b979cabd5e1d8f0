# SPDX-License-Identifier: BSD-3-Clause
"""The model and everything it needs, free of ROS and of bag formats."""
