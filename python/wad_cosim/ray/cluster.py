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
    from ray.util.placement_group import PlacementGroup, placement_group, placement_group_table, remove_placement_group
    from ray.util.scheduling_strategies import PlacementGroupSchedulingStrategy
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


@dataclasses.dataclass
class _Asked:
    """What an actor is asked for."""

    actor: Any
    #: When its time begins; the start of a process comes before.
    since: float
    #: Processes that were ended for it.
    ended: int = 0


class Actors:
    """Actors of one core each. The process of one that works on a task for ``limit`` seconds is ended: Ray watches nodes and processes, not
    progress. Ray then starts it again, and the task is done again.

    An actor that waits for a core is not late. Its core is a placement group of its own, since that is how Ray says whether it has one.
    One that lost its core with its node, and found no other, is stopped (``lost``): the caller starts another, which waits as a new one does.
    Ray would look for a core for it without a pause, with a whole core of the head's (Ray's pull request 65007).
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._asked: dict[Any, _Asked] = {}
        #: By actor.
        self._cores: dict[Any, PlacementGroup] = {}
        #: Those that have done a task.
        self._warm: set[Any] = set()
        #: Those that had lost their core at the last look, and those that were stopped for it.
        self._homeless: set[Any] = set()
        self._lost: set[Any] = set()

    def start(self, kind: type, *given: Any, **options: Any) -> Any:
        """A new actor, with Ray's ``options``."""
        core = placement_group([{"CPU": 1}])
        where = PlacementGroupSchedulingStrategy(core)
        actor: Any = ray.remote(num_cpus=1, scheduling_strategy=where, **options)(kind)
        actor = actor.remote(*given)
        self._cores[actor] = core
        return actor

    def lost(self, actor: Any) -> bool:
        """Whether it was stopped because it had lost its core: another is to be started, and given its task."""
        return actor in self._lost

    def stop(self, actor: Any) -> None:
        """Ends it, which gives its core to those that wait for one."""
        ray.kill(actor)
        remove_placement_group(self._cores.pop(actor))

    def stop_all(self) -> None:
        """Ends all."""
        for actor in list(self._cores):
            self.stop(actor)

    def begin(self, ref: Any, actor: Any) -> None:
        """``actor`` is asked for ``ref``."""
        now = time.monotonic()
        self._asked[ref] = _Asked(actor, now if actor in self._warm else now + self._limit)

    def end(self, ref: Any) -> None:
        """``ref`` is there: its actor begins the next one."""
        now, actor = time.monotonic(), self._asked.pop(ref).actor
        self._warm.add(actor)
        for asked in self._asked.values():
            if asked.actor == actor:
                asked.since = now

    def look(self) -> None:
        """Ends processes whose time is over.

        Raises:
            Error: It is over again and again for the same task.
        """
        now, groups = time.monotonic(), placement_group_table()
        states = {actor: groups.get(core.id.hex(), {}).get("state") for actor, core in self._cores.items()}
        homeless = {actor for actor, state in states.items() if state == "RESCHEDULING"}
        for actor in homeless & self._homeless:
            self.stop(actor)
            self._lost.add(actor)
        self._homeless = homeless - self._lost
        for asked in self._asked.values():
            if states.get(asked.actor) != "CREATED":
                asked.since = now + self._limit
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


def process() -> tuple[str, int]:
    """The node and the number of this process."""
    return ray.get_runtime_context().get_node_id(), os.getpid()


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


class Worker:
    """An actor: does tasks with what ``make`` made in its process, which stays warm between them."""

    def __init__(self, make: Callable[..., Callable[[Any], Any]], given: tuple[Any, ...]) -> None:
        self._do = make(*given)

    def do(self, task: Any) -> tuple[tuple[str, int], Any]:
        """The process, and the task's result."""
        return process(), self._do(task)


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

    A task whose worker or node dies is done again, so ``take`` may get a result twice. A result that was lost with
    its node is missing: its task is to be given again. ``runtime_env`` is Ray's, of the actors.
    """
    # A dead one comes back, here or on another node, and does its task again.
    options: dict[str, Any] = {"max_restarts": -1, "max_task_retries": -1, "runtime_env": runtime_env}
    waiting = collections.deque(tasks)
    # By worker's number.
    made: list[Any] = []
    doing: dict[Any, tuple[int, Any]] = {}
    actors = Actors(limit)

    def start() -> Any:
        return actors.start(Worker, make, given, **options)

    def give(number: int, task: Any) -> None:
        ref = made[number].do.remote(task)
        doing[ref] = number, task
        actors.begin(ref, made[number])

    try:
        while waiting or doing:
            if progress.is_due():
                progress.show()
                actors.look()
                # Nodes may join: then there are more cores.
                cores = workers or int(ray.cluster_resources().get("CPU", 1))
                while waiting and len(made) < cores:
                    made.append(start())
                    give(len(made) - 1, waiting.popleft())
            for ref in ray.wait(list(doing), num_returns=1, timeout=0.5)[0] if doing else ():
                number, task = doing.pop(ref)
                actors.end(ref)
                if actors.lost(made[number]):
                    made[number] = start()
                    give(number, task)
                    continue
                with contextlib.suppress(ray.exceptions.ObjectLostError), failures():
                    where, result = ray.get(ref)
                    progress.came_from(number, where)
                    progress.done = take(result)
                if waiting:
                    give(number, waiting.popleft())
                else:
                    actors.stop(made[number])
    finally:
        actors.stop_all()
