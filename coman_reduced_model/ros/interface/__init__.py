# SPDX-License-Identifier: BSD-3-Clause
"""What nodes take in and give out: QoS, parameters, robot description, outputs, diagnostics."""
