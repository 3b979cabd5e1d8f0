# SPDX-License-Identifier: BSD-3-Clause
"""Thousands of recordings: predicted and diagnosed by many processes, the results in three Parquet tables.

store.py       folders of any file system that fsspec knows
inventory.py   the bags below them; robots.py: which robot recorded a bag, and when
work.py        what a worker does with a bag, or with the bags of a robot; memory.py: how much it may take
local.py       workers as processes of this machine; cluster.py: as tasks of Ray
run.py         all tasks of an archive, again until each has its part
tables.py      the three tables, and how they are put together from the parts
report/        what became of each robot over the months
"""
