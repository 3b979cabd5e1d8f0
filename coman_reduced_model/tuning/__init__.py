# SPDX-License-Identifier: BSD-3-Clause
"""Constants from recordings: springs from experiments (`identify`), coefficients from walks (`tune`, `validate`)."""
