# SPDX-License-Identifier: BSD-3-Clause
"""Tasks on Ray: a cluster that runs already, or one of this machine alone. The only place that imports ray."""

from __future__ import annotations

import logging
import os
from collections.abc import Generator, Sequence
from typing import Any

from ..errors import ComanError, ConfigError
from .local import Outcome
from .work import DIED, Task, run_task

LOCAL = "local"
_AHEAD = 4  # tasks handed out for each core: enough that none waits, few enough to stop soon


def run_on_ray(tasks: Sequence[Task], address: str, workers: int) -> Generator[Outcome, None, None]:
    """Do all tasks; outcomes come as they are ready.

    Args:
        tasks: what to do; each is tried again when its worker dies.
        address: of a cluster (HOST:PORT, or `auto`), or `local`: Ray is started here, reachable by this machine only.
        workers: of `local`: how many at a time.

    Raises:
        ComanError: there is no such cluster, a worker has another version of the package, or cannot write its results.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address == LOCAL:
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # Ray's way to say: 127.0.0.1 and nothing else
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import ray

    try:
        if address == LOCAL:
            ray.init(LOCAL, num_cpus=workers, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
        else:
            ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise ConfigError(f"--address: {address}: {' '.join(str(error).split())[:200]}") from None
    try:
        yield from _run(ray.remote(num_cpus=1, max_retries=1)(run_task), tasks)
    finally:
        ray.shutdown()


def _run(remote: Any, tasks: Sequence[Task]) -> Generator[Outcome, None, None]:
    import ray

    most = _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
    waiting = list(reversed(tasks))
    running: dict[Any, Task] = {}
    while waiting or running:
        while waiting and len(running) < most:
            task = waiting.pop()
            running[remote.remote(task)] = task
        (ready,), _ = ray.wait(list(running), num_returns=1)
        task = running.pop(ready)
        try:
            yield task, ray.get(ready)
        except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError, ray.exceptions.NodeDiedError):
            yield task, DIED
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, ComanError):  # one line, as it was on the worker
                raise error.cause from None
            raise
