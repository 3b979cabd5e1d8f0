# SPDX-License-Identifier: BSD-3-Clause
"""Input streams: which messages count, and how they are joined into samples by stamp."""
