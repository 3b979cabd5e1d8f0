# SPDX-License-Identifier: BSD-3-Clause
"""The exceptions of this package: one root, so that callers can catch what is theirs to report.

Every message is one line that says what is wrong and where (file, key, topic, joint), with the value
found and what is allowed. The command line prints it and exits 2; a node logs it and stops cleanly.
"""


class ComanError(Exception):
    """Root of all errors that are caused by the input, never by a bug of this package."""


class ConfigError(ComanError):
    """A configuration key is unknown, of the wrong type, or out of its range."""


class RobotError(ComanError):
    """A URDF cannot be used: unreadable, without mass, or lacking a named joint or frame."""


class BagError(ComanError):
    """A bag cannot be read: missing, empty, of another format, or without the needed topics."""


class OutputError(ComanError):
    """An output location cannot be used: it exists already, or cannot be written."""


class EngineError(ComanError):
    """A physics engine cannot go on: the motion or the contact is beyond what it can simulate."""
