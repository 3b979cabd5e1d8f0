# SPDX-License-Identifier: BSD-3-Clause
"""What is known of the robot's motion, from all sensors at once, and how sure it is."""
