# SPDX-License-Identifier: BSD-3-Clause
"""A blind test of the diagnosis: robots with hidden effects, their recordings, and a score of the verdicts.

families.py   the hidden effects, and the sizes of weak, medium and strong ones
cases.py      cases drawn by seed, and their bags
seeds.yaml    seeds on which something was chosen or reported; seeds.py reads it and finds a fresh range
run.py        the diagnosis as a process that gets the bags and nothing else
baselines.py  simpler methods on the same bags
score.py      verdicts against answers
"""
