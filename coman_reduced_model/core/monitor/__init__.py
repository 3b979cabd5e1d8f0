# SPDX-License-Identifier: BSD-3-Clause
"""Online change detection: laws of mechanics, and inputs that contradict each other."""
