# SPDX-License-Identifier: BSD-3-Clause
"""The discrepancy workflow: where simulation and measurement disagree, and which effect is missing."""
