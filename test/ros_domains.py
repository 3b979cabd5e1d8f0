# SPDX-License-Identifier: BSD-3-Clause
"""ROS domains for tests: drawn at random, each for one owner at a time."""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path

# What DDS takes for domains beside the ports that the system hands out.
_DOMAINS = range(1, 102)


@contextlib.contextmanager
def domain_of_its_own() -> Iterator[str]:
    """A domain that no other test on this machine has, as `ROS_DOMAIN_ID` of this process and what it starts.

    Each domain has a file that its owner locks. Drawing alone is not enough: with a hundred tests beside each other,
    every second run has two on one domain.
    """
    folder = Path(tempfile.gettempdir()) / f"coman_test_domains.{os.getuid()}"
    folder.mkdir(exist_ok=True)
    before = os.environ.get("ROS_DOMAIN_ID")
    for domain in random.SystemRandom().sample(_DOMAINS, len(_DOMAINS)):
        with (folder / str(domain)).open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            os.environ["ROS_DOMAIN_ID"] = str(domain)
            try:
                yield str(domain)
            finally:
                if before is None:
                    del os.environ["ROS_DOMAIN_ID"]
                else:
                    os.environ["ROS_DOMAIN_ID"] = before
            return
    raise RuntimeError(f"each of the {len(_DOMAINS)} ROS domains has a test")
