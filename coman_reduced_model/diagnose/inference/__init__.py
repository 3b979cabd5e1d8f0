# SPDX-License-Identifier: BSD-3-Clause
"""Which effects explain the residuals: noise floor, evidence, search."""
