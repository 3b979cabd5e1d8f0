# SPDX-License-Identifier: BSD-3-Clause
"""The nodes: thin adapters between ROS 2 topics and the core. Only these and `coman replay` import rclpy."""
