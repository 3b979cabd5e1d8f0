# SPDX-License-Identifier: BSD-3-Clause
"""What everything else is made of: data types, parameters, compilation and small linear algebra."""
