# SPDX-License-Identifier: BSD-3-Clause
"""Effects: what can be added to the paper's model, by name."""
