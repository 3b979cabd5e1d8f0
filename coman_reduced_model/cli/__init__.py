# SPDX-License-Identifier: BSD-3-Clause
"""The command line `coman`: one file a command, what they share in common.py."""
