# SPDX-License-Identifier: BSD-3-Clause
"""The trunk on its legs, free to turn, with the contact of the feet."""
