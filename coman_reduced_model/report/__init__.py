# SPDX-License-Identifier: BSD-3-Clause
"""Pages and figures about results, in `prediction` and `validation`. Others are made of `run`, `figures`, `page`.

Nothing is imported here: the drawing library takes seconds.
"""
