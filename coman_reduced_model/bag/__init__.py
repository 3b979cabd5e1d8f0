# SPDX-License-Identifier: BSD-3-Clause
"""Recordings (rosbag2) read and written without ROS."""
