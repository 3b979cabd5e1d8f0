# SPDX-License-Identifier: BSD-3-Clause
"""The nodes: thin adapters between ROS 2 topics and the core. The only place that imports rclpy."""
