"""A Ray cluster, and work that its actors share."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import os
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from .._native import Error, InputError

try:
    import ray
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


@contextlib.contextmanager
def failures() -> Iterator[None]:
    """Ray's exceptions as this package's: what a task raised itself, else that Ray failed. A result that was lost with its node is
    the caller's: its task is to be given again."""
    try:
        yield
    except ray.exceptions.ObjectLostError:
        raise
    except ray.exceptions.RayTaskError as error:
        raise error.cause if isinstance(error.cause, Exception) else error from None
    except ray.exceptions.RayError as error:
        raise Error(f"Ray failed: {error}") from None


#: Seconds after which a task counts as hung, unless the user says otherwise: much longer than an episode takes.
LIMIT = 1800.0
#: Processes that are ended for one task, one after the other, before the work ends with an error.
_ATTEMPTS = 3


class Located:
    """An actor that says where it is."""

    def where(self) -> str:
        """The id of its node."""
        found: str = ray.get_runtime_context().get_node_id()
        return found


@dataclasses.dataclass
class _Asked:
    """What an actor is asked for."""

    actor: Any
    since: float
    #: Processes that were ended for it.
    ended: int = 0


class Watch:
    """Ends the process of an actor that works on a task for ``limit`` seconds: Ray watches nodes and processes, not progress. Ray then
    starts it again, and the task is done again.

    An actor that waits for a core, at first or after its node's death, is not late: time counts where it is known to be on a node
    that lives.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._asked: dict[Any, _Asked] = {}
        #: By actor: its node's id, or what will say it.
        self._nodes: dict[Any, Any] = {}

    def begin(self, ref: Any, actor: Any) -> None:
        """``actor`` is asked for ``ref``. Call :meth:`meet` before its first."""
        self._asked[ref] = _Asked(actor, time.monotonic())

    def meet(self, actor: Any) -> None:
        """A new actor; it is asked where it is."""
        self._nodes[actor] = actor.where.remote()

    def end(self, ref: Any, node: str | None = None) -> None:
        """``ref`` is there, from ``node``."""
        asked = self._asked.pop(ref)
        if node is not None:
            self._nodes[asked.actor] = node

    def look(self) -> None:
        """Ends processes whose time is over.

        Raises:
            Error: It is over again and again for the same task.
        """
        now, alive = time.monotonic(), {node["NodeID"] for node in ray.nodes() if node["Alive"]}
        for asked in self._asked.values():
            if self._node(asked.actor) not in alive:
                asked.since = now
            elif now - asked.since >= self._limit:
                asked.ended += 1
                if asked.ended == _ATTEMPTS:
                    raise Error(
                        f"a worker was not done with a task after {self._limit:g} s, {_ATTEMPTS} times in a row: give it "
                        "longer with --task-timeout, or look at the machine that it runs on"
                    )
                ray.kill(asked.actor, no_restart=False)
                # As long again for the start of the next process.
                asked.since = now + self._limit

    def _node(self, actor: Any) -> str | None:
        node = self._nodes[actor]
        if isinstance(node, ray.ObjectRef):
            if not ray.wait([node], timeout=0)[0]:
                return None
            try:
                node = self._nodes[actor] = ray.get(node)
            except ray.exceptions.RayError:
                # Its answer was lost with its node; its next result says where it is.
                node = self._nodes[actor] = ""
        return str(node)


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

    def say(self, text: str) -> None:
        """Writes a line of its own."""
        print(f"\r{text}\033[K" if self._again else text, file=sys.stderr, flush=True)

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


class Worker(Located):
    """An actor: does tasks with what ``make`` made in its process, which stays warm between them."""

    def __init__(self, number: int, make: Callable[..., Callable[[Any], Any]], given: tuple[Any, ...]) -> None:
        self._number, self._do = number, make(*given)

    def do(self, task: Any) -> tuple[int, tuple[str, int], Any]:
        """The task's result, and whose it is."""
        return self._number, (self.where(), os.getpid()), self._do(task)


def share(
    tasks: list[Any],
    make: Callable[..., Callable[[Any], Any]],
    given: tuple[Any, ...],
    workers: int | None,
    limit: float,
    progress: Progress,
    take: Callable[[Any], int],
    runtime_env: dict[str, Any] | None = None,
) -> None:
    """Has ``tasks`` done by actors, each within ``limit`` seconds, and hands each result to ``take``, which says how many are done.

    A task whose worker or node dies is done again by Ray, so ``take`` may get a result twice. A result that was lost with
    its node is missing: its task is to be given again. ``runtime_env`` is Ray's, of the actors.
    """
    # A core for each; a dead one comes back, here or on another node, and does its task again.
    actor: Any = ray.remote(num_cpus=1, max_restarts=-1, max_task_retries=-1)(Worker)
    if runtime_env is not None:
        actor = actor.options(runtime_env=runtime_env)
    waiting, made = collections.deque(tasks), 0
    doing: dict[Any, Any] = {}
    watch = Watch(limit)

    def give(worker: Any) -> None:
        ref = worker.do.remote(waiting.popleft())
        doing[ref] = worker
        watch.begin(ref, worker)

    while waiting or doing:
        if progress.is_due():
            progress.show()
            watch.look()
            # Nodes may join: then there are more cores.
            cores = workers or int(ray.cluster_resources().get("CPU", 1))
            while waiting and made < cores:
                worker = actor.remote(made, make, given)
                made += 1
                watch.meet(worker)
                give(worker)
        for ref in ray.wait(list(doing), num_returns=1, timeout=0.5)[0] if doing else ():
            worker, node = doing.pop(ref), None
            with contextlib.suppress(ray.exceptions.ObjectLostError), failures():
                number, process, result = ray.get(ref)
                node, _ = process
                progress.came_from(number, process)
                progress.done = take(result)
            watch.end(ref, node)
            if waiting:
                give(worker)
            else:
                # It ends, and gives its core to those that wait for one after their node's death.
                ray.kill(worker)
