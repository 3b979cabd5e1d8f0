# SPDX-License-Identifier: BSD-3-Clause
"""The judge of the discrepancy workflow: robots with hidden effects, their recordings, and what the verdicts are worth.

families.py   what can be hidden and how much of it is weak, medium, strong
cases.py      cases drawn by seed, and their bags
run.py        the workflow as a process that sees nothing but the bags
score.py      verdicts against answers
baselines.py  what simpler methods say about the same bags
"""
