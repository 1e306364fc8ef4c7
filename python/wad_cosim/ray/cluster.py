"""A Ray cluster, and work that its actors share."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from .._native import Error, InputError

try:
    import ray
    from ray.util import ActorPool
except ImportError as missing:
    raise InputError("Ray is not installed: pip install 'wad-cosim[ray]'") from missing


@contextlib.contextmanager
def connected(address: str, workers: int | None) -> Iterator[None]:
    """Ray at ``address``: ``auto`` (the cluster that this process or machine is part of), ``local`` or HOST:PORT."""
    if ray.is_initialized():
        yield
        return
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "warning"}
    if address == "local":
        options.update(num_cpus=workers, include_dashboard=False)
    try:
        ray.init(address=address, **options)
    except ConnectionError as error:
        raise InputError(f"no Ray cluster at address={address!r}: start one, or use `local` ({error})") from None
    try:
        yield
    finally:
        ray.shutdown()


class Progress:
    """How far the work is, on stderr: a line that is written again on a terminal, else a new one every ten seconds."""

    def __init__(self, unit: str, done: int, planned: int, shown: bool) -> None:
        self._unit, self._planned, self._shown = unit, planned, shown
        self._first, self._began = done, time.monotonic()
        self._looked = self._said = -10.0
        self._again = sys.stderr.isatty()
        self._processes: dict[int, tuple[str, int]] = {}
        self.done = done
        #: Restarts of workers that have given a result since.
        self.restarts = 0

    def came_from(self, worker: int, process: tuple[str, int]) -> None:
        """A result of ``worker``, from the process of this node and number."""
        if self._processes.setdefault(worker, process) != process:
            self._processes[worker] = process
            self.restarts += 1

    def started_again(self) -> None:
        """All workers were started again, for one reason."""
        self._processes.clear()
        self.restarts += 1

    def is_due(self) -> bool:
        """Whether half a second is over since it was last."""
        now = time.monotonic()
        due = now - self._looked >= 0.5
        if due:
            self._looked = now
        return due

    def show(self, last: bool = False) -> None:
        """Writes the line."""
        now = time.monotonic()
        if not self._shown or not (last or self._again or now - self._said >= 10):
            return
        self._said = now
        nodes = sum(bool(node["Alive"]) for node in ray.nodes())
        rate = (self.done - self._first) / max(now - self._began, 1e-9)
        left = f"{max(self._planned - self.done, 0) / rate:.0f} s left" if rate > 0 else "time left unknown"
        text = (
            f"{self.done}/{self._planned} {self._unit}, {3600 * rate:.0f} an hour, {left}, "
            f"{nodes} nodes, {self.restarts} restarts"
        )
        end = "\n" if last or not self._again else ""
        print(f"\r{text}\033[K" if self._again else text, end=end, file=sys.stderr, flush=True)


class Worker:
    """An actor: does tasks with what ``make`` made in its process, which stays warm between them."""

    def __init__(self, number: int, make: Callable[..., Callable[[Any], Any]], given: tuple[Any, ...]) -> None:
        self._number, self._do = number, make(*given)

    def do(self, task: Any) -> tuple[int, tuple[str, int], Any]:
        """The task's result, and whose it is."""
        node = ray.get_runtime_context().get_node_id()
        return self._number, (node, os.getpid()), self._do(task)


def share(
    tasks: list[Any],
    make: Callable[..., Callable[[Any], Any]],
    given: tuple[Any, ...],
    workers: int | None,
    progress: Progress,
    take: Callable[[Any], int],
) -> None:
    """Has ``tasks`` done by actors, and hands each result to ``take``, which says how many are done.

    A task whose worker or node dies is done again by Ray, so ``take`` may get a result twice. A result that was lost with
    its node is missing: its task is to be given again.
    """
    # A core for each; a dead one comes back, here or on another node, and does its task again.
    actor: Any = ray.remote(num_cpus=1, max_restarts=-1, max_task_retries=-1)(Worker)
    pool, waiting, made = ActorPool([]), len(tasks), 0
    for task in tasks:
        pool.submit(lambda worker, task: worker.do.remote(task), task)
    while waiting:
        if progress.is_due():
            progress.show()
            # Nodes may join: then there are more cores.
            cores = workers or int(ray.cluster_resources().get("CPU", 1))
            while made < min(cores, waiting):
                pool.push(actor.remote(made, make, given))
                made += 1
        # A worker without a task gives its core to those that wait for one after their node's death.
        while pool.pop_idle() is not None:
            pass
        try:
            number, process, result = pool.get_next_unordered(timeout=0.5)
        except TimeoutError:
            continue
        except ray.exceptions.ObjectLostError:
            waiting -= 1
            continue
        except ray.exceptions.RayTaskError as error:
            raise error.cause if isinstance(error.cause, Exception) else error from None
        except ray.exceptions.RayError as error:
            raise Error(f"Ray failed: {error}") from None
        waiting -= 1
        progress.came_from(number, process)
        progress.done = take(result)
