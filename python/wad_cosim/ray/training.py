"""Training on Ray: the driver has the folder, collectors drive, one learner learns.

A collector's segments go to the learner as they come, and it drives the next ones with the newest weights; it is at most one turn
ahead of the learner. A collector that dies is started again by Ray, and what it was driving is driven again. When the learner
dies, both halves start again from the last checkpoint, which the driver keeps: the same way as after the driver's own death.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import itertools
import json
import os
import pathlib
import time
from collections.abc import Iterator
from typing import Any

from .. import learn
from .._native import Error, InputError
from ..learn import training
from ..learn.training import Published, Settings, steps_of, write_agent
from . import cluster

# After `cluster`, which says how to install it.
import ray

#: Seconds between two lines of losses in the log; every checkpoint has one too.
_FIGURES = 5.0


class Collector(training.Collector):
    """A collector on a node; its first result also says whose it is."""

    def drive(self, *given: Any) -> Any:
        episodes, segments = super().drive(*given)
        return (cluster.process(), episodes), segments


class _LearnerLost(Exception):
    """The learner's process or node died."""


class _TurnLost(Exception):
    """What a collector drove in a turn was lost with its node."""


class Folder:
    """A training's results: settings.json, config.json, train.jsonl, checkpoint.pt, last.safetensors."""

    def __init__(self, path: str | os.PathLike[str], settings: Settings, resume: bool) -> None:
        self.path = pathlib.Path(path)
        self._checkpoint, own, config = (self.path / name for name in ("checkpoint.pt", "settings.json", "config.json"))
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            # As the command line locks its folders; the system releases it however this process ends.
            self._lock = open(self.path / ".lock", "a")
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if resume and own.exists():
                settings = _settings(own)
            elif resume:
                raise InputError(f"{self.path}: there is no training of this program to resume")
            elif own.exists() or config.exists():
                raise InputError(f"{self.path} holds a training already: --resume goes on with it, or name another folder")
            settings.check()
            # The second is for `report learning`.
            for path, content in ((own, dataclasses.asdict(settings)), (config, settings.config())):
                if not path.exists():
                    _write(path, json.dumps(content, indent=2).encode() + b"\n")
        except BlockingIOError:
            raise InputError(f"another process is writing into {self.path}: let it end, or name another folder with --out") from None
        except OSError as error:
            raise InputError(f"cannot write {self.path}: {error}") from None
        self.settings = settings

    def checkpoint(self) -> bytes | None:
        """The last one; None at the begin. The log is cut to what its learner has learned from."""
        if not self._checkpoint.exists():
            self._rewind(-1)
            return None
        found = self._checkpoint.read_bytes()
        try:
            steps = steps_of(found)
        except Exception as error:
            raise InputError(f"{self._checkpoint} is damaged: {error}") from None
        self._rewind(steps)
        return found

    def _rewind(self, steps: int) -> None:
        log = self.path / "train.jsonl"
        kept = []
        for line in log.read_text().splitlines() if log.exists() else ():
            # The last line of a process that was killed is not whole.
            with contextlib.suppress(ValueError):
                if json.loads(line)["global_step"] <= steps:
                    kept.append(line + "\n")
        with _told(log):
            _write(log, "".join(kept).encode())

    def log(self, lines: list[dict[str, Any]]) -> None:
        """Adds lines to the log."""
        log = self.path / "train.jsonl"
        with _told(log), open(log, "a") as file:
            file.writelines(json.dumps(line) + "\n" for line in lines)

    def save(self, checkpoint: bytes) -> None:
        """Keeps a checkpoint, and its actor as an agent's file."""
        agent = self.path / "last.safetensors"
        with _told(self._checkpoint):
            _write(self._checkpoint, checkpoint)
        with _told(agent):
            write_agent(checkpoint, self.settings, agent)

    def close(self) -> None:
        """Lets others write into it."""
        self._lock.close()


def _settings(config: pathlib.Path) -> Settings:
    try:
        return Settings.of(json.loads(config.read_bytes()))
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{config} is not a training's: {error}") from None


def _write(path: pathlib.Path, content: bytes) -> None:
    """Whole or not at all."""
    part = path.with_name(path.name + ".part")
    try:
        with open(part, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError:
        # On a full disk it would only take room.
        part.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def _told(path: pathlib.Path) -> Iterator[None]:
    """That ``path`` cannot be written, as on a full disk, as this package's error: the training ends with it."""
    try:
        yield
    except (OSError, InputError) as error:
        raise Error(f"cannot write {path}: {error}; the last checkpoint stays, and --resume goes on from it") from None


#: A learner that dies so often in a row before it has begun does not start. Once is not enough: Ray may put it on the node
#: whose death it has not noticed yet.
_LEARNER_STARTS = 5


def train(
    settings: Settings,
    out: str | os.PathLike[str],
    *,
    steps: int,
    address: str = "auto",
    workers: int | None = None,
    limit: float = cluster.LIMIT,
    resume: bool = False,
    progress: bool = False,
) -> dict[str, Any]:
    """Trains until ``steps`` transitions are taken; returns steps, updates, episodes, restarts.

    ``workers`` is the number of collectors; default: the cluster's cores less one, which the learner has. A turn or
    an update that takes longer than ``limit`` seconds counts as hung. Ctrl-C leaves a checkpoint.

    Raises:
        InputError: An argument is wrong, ``out`` holds another training, or another process writes into it.
        SumoError: SUMO does not start.
        Error: Training failed.
    """
    learn.prepare()
    folder = Folder(out, settings, resume)
    try:
        first = folder.checkpoint()
        bar = cluster.Progress("steps", steps_of(first) if first else 0, steps, progress)
        local = (workers or max((os.cpu_count() or 2) - 1, 1)) + 1
        with cluster.connected(address, local):
            failed = 0
            while True:
                run = _Run(folder, workers, limit, bar)
                try:
                    with run:
                        return run.until(steps)
                except _LearnerLost as lost:
                    failed = 0 if run.began else failed + 1
                    if failed == _LEARNER_STARTS:
                        raise Error(f"the learner does not start: {lost}") from None
                    bar.started_again()
                    bar.say(f"the learner died ({lost}): on from the last checkpoint")
    finally:
        folder.close()


class _Run:
    """A learner and its collectors, from the last checkpoint on."""

    def __init__(self, folder: Folder, workers: int | None, limit: float, bar: cluster.Progress) -> None:
        self._folder, self._settings, self._workers, self._bar = folder, folder.settings, workers, bar
        self._actors = cluster.Actors(limit)
        self._learner: Any = self._actors.start(training.Learner, self._settings, folder.checkpoint())
        self._collectors: list[Any] = []
        #: By collector: turns that it has begun, and those that the learner has not taken yet.
        self._turns: list[int] = []
        self._untaken: list[int] = []
        #: What is awaited: what collectors say with their segments, and what the learner says of them.
        self._driving: dict[Any, tuple[int, Any]] = {}
        self._learning: dict[Any, tuple[int, list[dict[str, Any]]]] = {}
        self._figures: dict[str, list[float]] = {}
        self._told = (time.monotonic(), 0, 0)
        self._episodes = 0
        #: Whether the learner has answered.
        self.began = False

    def __enter__(self) -> _Run:
        return self

    def __exit__(self, *_: object) -> None:
        # Their SUMOs end with them.
        self._actors.stop_all()

    def until(self, steps: int) -> dict[str, Any]:
        """Learns until ``steps`` transitions are taken."""
        # The learner first: collectors would take its core.
        self._publish(self._ask(self._learn("published")))
        self.began = True
        self._told = (time.monotonic(), self._state.steps, self._state.updates)
        saved = self._state.steps
        try:
            while self._state.steps < steps:
                self._go(steps)
                if self._state.steps - saved >= self._settings.checkpoint_every:
                    saved = self._save()
        except KeyboardInterrupt:
            self._save()
            raise
        self._save()
        self._bar.show(last=True)
        return {
            "out": str(self._folder.path),
            "steps": self._state.steps,
            "updates": self._state.updates,
            "episodes": self._episodes,
            "restarts": self._bar.restarts,
        }

    def _go(self, steps: int) -> None:
        """Waits for news, at most half a second."""
        if self._bar.is_due():
            self._bar.show()
            self._actors.look()
            self._hire()
        # The learner answers in the order in which it was asked, but a later answer may be on this node first.
        awaited = [*itertools.islice(self._learning, 1), *self._driving]
        if not awaited:
            time.sleep(0.1)
            return
        for ref in ray.wait(awaited, num_returns=1, timeout=0.5)[0]:
            if ref in self._learning:
                self._learned(ref)
            else:
                self._driven(ref)

    def _hire(self) -> None:
        """Starts collectors, as many as there are cores; nodes may join."""
        cores = int(ray.cluster_resources().get("CPU", 1))
        while len(self._collectors) < (self._workers or max(cores - 1, 1)):
            number = len(self._collectors)
            self._collectors.append(self._collector(number))
            self._turns.append(0)
            self._untaken.append(0)
            self._drive(number)

    def _collector(self, number: int) -> Any:
        # A dead one comes back, here or on another node, and drives its turn again.
        return self._actors.start(Collector, number, self._settings, self._state.steps, max_restarts=-1, max_task_retries=-1)

    def _drive(self, number: int) -> None:
        if self._actors.lost(self._collectors[number]):
            self._collectors[number] = self._collector(number)
        self._turns[number] += 1
        learns = self._state.updates > 0
        drive = self._collectors[number].drive.options(num_returns=2)
        news, segments = drive.remote(self._turns[number], self._weights, learns, self._state.stage)
        self._driving[news] = (number, segments)
        self._actors.begin(news, self._collectors[number])

    def _driven(self, ref: Any) -> None:
        """A collector has driven its turn: the learner gets the segments."""
        number, segments = self._driving.pop(ref)
        if self._actors.lost(self._collectors[number]):
            self._actors.end(ref)
            self._drive(number)
            return
        try:
            process, episodes = self._ask(ref, died="a collector does not start")
        except _TurnLost:
            self._drive(number)
            return
        self._bar.came_from(number, process)
        self._learning[self._learn("take", segments, episodes)] = (number, episodes)
        self._untaken[number] += 1
        if self._untaken[number] == 1:
            self._drive(number)

    def _learned(self, ref: Any) -> None:
        """The learner has taken a turn's segments, and learned."""
        number, episodes = self._learning.pop(ref)
        try:
            self._publish(self._ask(ref))
            self._note(episodes)
        except _TurnLost:
            # Its segments were still on the node that died, and its collector has found no other that would drive them again.
            pass
        self._untaken[number] -= 1
        if not any(number == other for other, _ in self._driving.values()):
            self._drive(number)

    def _learn(self, method: str, *given: Any) -> Any:
        """What will be the learner's answer."""
        ref = getattr(self._learner, method).remote(*given)
        self._actors.begin(ref, self._learner)
        return ref

    def _ask(self, ref: Any, died: str | None = None) -> Any:
        """The answer. An actor that is dead for good is the learner, or else it ``died``."""
        try:
            with cluster.failures():
                while not ray.wait([ref], timeout=0.5)[0]:
                    self._actors.look()
                try:
                    return ray.get(ref)
                except (ray.exceptions.RayActorError, ray.exceptions.ObjectLostError) as error:
                    if isinstance(error, ray.exceptions.RayTaskError) or died and isinstance(error, ray.exceptions.ObjectLostError):
                        # The actor lives, and says that of what it was given; or its answer was lost on the way.
                        raise _TurnLost from None
                    if died:
                        raise Error(f"{died}: {error}") from None
                    raise _LearnerLost(str(error).splitlines()[0]) from None
        finally:
            self._actors.end(ref)

    def _publish(self, state: Published) -> None:
        self._state = state
        # On the driver's node, so that they outlive the learner's.
        self._weights = ray.put(state.weights)
        self._bar.done = state.steps

    def _note(self, episodes: list[dict[str, Any]]) -> None:
        state = self._state
        lines = [{"global_step": state.steps, **episode} for episode in episodes]
        lines += [{"global_step": state.steps, "passed": passed} for passed in state.passed]
        self._episodes += len(episodes)
        for passed in state.passed:
            task = self._settings.task(passed["stage"])
            how = "is passed" if passed["threshold"] else "is left, its steps are spent"
            self._bar.say(f"step {state.steps}: stage {passed['stage'] + 1} ({task}) {how}")
        for name, loss in state.losses.items():
            self._figures.setdefault(name, []).append(loss)
        if time.monotonic() - self._told[0] >= _FIGURES:
            lines += self._means()
        self._folder.log(lines)

    def _means(self) -> list[dict[str, Any]]:
        """The log's line of losses and speeds since the last such line, if there is anything to tell."""
        if not self._figures:
            return []
        now, state, (then, steps, updates) = time.monotonic(), self._state, self._told
        figures = {name: sum(values) / len(values) for name, values in self._figures.items()}
        figures["charts/SPS"] = (state.steps - steps) / (now - then)
        figures["charts/UPS"] = (state.updates - updates) / (now - then)
        figures |= {"charts/updates": state.updates, "charts/buffer": state.buffer, "charts/hours": state.hours}
        self._figures, self._told = {}, (now, state.steps, state.updates)
        return [{"global_step": state.steps, **figures}]

    def _save(self) -> int:
        """Keeps a checkpoint, of all that the log has; returns its steps."""
        for ref in list(self._learning):
            self._learned(ref)
        self._folder.log(self._means())
        self._folder.save(self._ask(self._learn("save")))
        return self._state.steps
