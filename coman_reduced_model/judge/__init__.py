# SPDX-License-Identifier: BSD-3-Clause
"""A blind test of the diagnosis: robots with hidden effects, their recordings, and a score of the verdicts.

families.py     the hidden effects; sizes.yaml: what weak, medium and strong mean; sizes.py: beside recordings
cases.py        cases drawn by seed, each in a world of sim/worlds, and their bags
seeds.yaml      seeds on which something was chosen or reported; seeds.py reads it and finds a fresh range
run.py          the diagnosis as a process that gets the bags and nothing else
baselines.py    simpler methods on the same bags
rank.py         an oracle that is given how much clean robots vary (variability.py), and not the effect
score.py        verdicts against answers; by_kind.py: by kind of world
prediction.py   the prediction on clean robots
monitor.py      the monitor on clean robots, and on effects that begin in mid-walk (sudden.py)
foreign.py      recordings with answers that this project did not make
"""
