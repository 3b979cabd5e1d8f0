# SPDX-License-Identifier: BSD-3-Clause
"""Pages and figures about results. Other reports are made of the same parts: `run`, `figures`, `page`."""

from .prediction import write_report

__all__ = ["write_report"]
