# SPDX-License-Identifier: BSD-3-Clause
"""The deflection that a plan asks for: a feedforward that no measurement enters."""
