# SPDX-License-Identifier: BSD-3-Clause
"""What the commands do with running nodes: replay a bag, the demo, the live view."""
