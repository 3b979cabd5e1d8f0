# SPDX-License-Identifier: BSD-3-Clause
"""The virtual robot: full-body physics in MuJoCo, its sensors, and the recorder of bags.

Independent of what it is there to test: nothing in here imports the reduced model. It shares the messages
(core/base/types), the gait generator (core/gait) and the table of figures (sim/robot_table).
"""
