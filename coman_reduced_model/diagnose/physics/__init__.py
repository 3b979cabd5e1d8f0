# SPDX-License-Identifier: BSD-3-Clause
"""Residuals of the laws of mechanics, and what effects do to them."""
