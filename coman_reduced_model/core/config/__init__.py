# SPDX-License-Identifier: BSD-3-Clause
"""The configuration: the table of parameters, its check, and its files."""
