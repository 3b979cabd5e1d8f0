# SPDX-License-Identifier: BSD-3-Clause
"""How nodes are started, spun and stopped."""
