"""A training's two halves, wherever they run: :class:`Collector` drives egos and cuts what they do into segments, :class:`Learner` takes
segments and publishes weights by version."""

from __future__ import annotations

import collections
import io
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from .. import _native, observations
from .._native import Error, InputError, SumoError
from ..evaluation import save_agent
from ..info import TERMS
from ..registry import suites
from ..vector import DrivingVectorEnv
from . import ALGORITHMS, exploration, new, places, prepare
from .curriculum import Curriculum, Progress, Stage
from .exploration import Noise
from .networks import HIGH, LOW, RAW, latent_size
from .replay import NEAR, ReplayBuffer, Segment

#: An actor's numbers by name.
Weights = dict[str, NDArray[np.float32]]

#: Segments in a row in which SUMO died, after which a collector gives up.
_PATIENCE = 5
#: Seconds of a tick.
_TICK = 0.167


@dataclass(frozen=True)
class Settings:
    """Everything that changes what is learned; saved as a training's settings.json."""

    #: td3 (WAD-T) or sac (WAD-S).
    algo: str = "td3"
    #: The environments' ids; collectors have them in turns.
    environments: tuple[str, ...] = ("wad_cosim/Straight-v0",)
    #: The tasks step by step, in place of ``environments``, with its own town, traffic and weathers.
    curriculum: Curriculum | None = None
    #: What the agent gets: raw, vector or latent.
    observation: str = "raw"
    #: None: the environment's own.
    town: str | None = None
    traffic: str | None = None
    weathers: tuple[str, ...] = ()
    #: None: truth for latent, else outlines.
    detector: str | None = None
    #: In each collector's SUMO.
    egos: int = 4
    #: Ticks of a segment: what the loss of a collector loses of each ego.
    segment: int = 32
    seed: int = 0
    #: Steps of random driving first.
    learning_starts: int = 5_000
    #: Updates for a step.
    update_ratio: float = 1.0
    batch: int = 128
    #: Rewards that are summed before the critics' estimate.
    n_step: int = 3
    #: Share of each batch that is drawn from the places where episodes end; 0: drawn uniformly.
    near_ends: float = 0.3
    #: Transitions that are kept.
    buffer: int = 200_000
    #: Deviation to which the latent is scaled.
    latent_gain: float = 0.02
    #: Steps between checkpoints.
    checkpoint_every: int = 10_000

    def check(self) -> None:
        """Refuses what cannot be."""
        latent_size(self.observation)
        problems = {
            f"algo={self.algo!r}: expected one of {', '.join(ALGORITHMS)}": self.algo not in ALGORITHMS,
            "environments: expected one or more": not self.environments,
            f"egos={self.egos}, segment={self.segment}, batch={self.batch}, n_step={self.n_step}, checkpoint_every="
            f"{self.checkpoint_every}: expected 1 or more": min(
                self.egos, self.segment, self.batch, self.n_step, self.checkpoint_every
            )
            < 1,
            "curriculum: it has tasks, town, traffic and weathers; leave out environments, town, traffic and weathers": (
                self.curriculum is not None
                and (self.environments, self.town, self.traffic, self.weathers) != (Settings.environments, None, None, ())
            ),
            f"near_ends={self.near_ends}: expected 0 to 1": not 0 <= self.near_ends <= 1,
            f"update_ratio={self.update_ratio}: expected 0 to 64": not 0 <= self.update_ratio <= 64,
            f"learning_starts={self.learning_starts}: expected a batch ({self.batch}) or more": self.learning_starts < self.batch,
            f"buffer={self.buffer}: expected 1024 or more": self.buffer < 1024,
        }
        for problem, found in problems.items():
            if found:
                raise InputError(problem)
        for id in self.environments:
            if id not in gymnasium.registry:
                raise InputError(f"environments: {id!r} is none of wad_cosim.ids()")

    @property
    def found_by(self) -> str:
        """The detector."""
        return self.detector or observations.found_by(self.observation)

    def choose(self, number: int, stage: int, rng: np.random.Generator) -> int:
        """Which task collector ``number`` drives next, at this stage of the curriculum: a stage's number or an environment's."""
        if self.curriculum is not None:
            return self.curriculum.draw(stage, rng)
        return number % len(self.environments)

    def task(self, index: int) -> str:
        """The name of the task of that number."""
        if self.curriculum is not None:
            return self.curriculum.stages[index].task
        kwargs = gymnasium.spec(self.environments[index]).kwargs
        tasks = suites()[kwargs["suite"]]["tasks"] if "suite" in kwargs else []
        kinds = [task["kind"] for task in tasks if task["name"] == kwargs["task"]]
        return str(kinds[0] if kinds else kwargs.get("task", "navigation"))

    def make(self, index: int) -> DrivingVectorEnv:
        """Egos in one SUMO with the task of that number."""
        if self.curriculum is not None:
            stage, town, weathers = self.curriculum.stages[index], self.curriculum.town, self.curriculum.weathers
            kwargs: dict[str, Any] = {"suite": None, "task": stage.task}
            given = {"town": town, "traffic": stage.traffic, "weather": weathers}
        else:
            kwargs = dict(gymnasium.spec(self.environments[index]).kwargs)
            given = {"town": self.town, "traffic": self.traffic, "weather": self.weathers or None}
        kwargs.update({name: value for name, value in given.items() if value is not None})
        kwargs.update(mode="training", observation=self.observation, detector=self.found_by, egos=self.egos)
        return DrivingVectorEnv(self.egos, **kwargs)

    @staticmethod
    def of(found: dict[str, Any]) -> Settings:
        """Settings of JSON's values.

        Raises:
            InputError, TypeError: They are none.
        """
        given: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in found.items()}
        if given.get("curriculum") is not None:
            given["curriculum"] = Curriculum.of(given["curriculum"])
        return Settings(**given)

    def config(self) -> dict[str, Any]:
        """The same as ``train agent`` writes it into config.json, for ``report learning``. What it has and this trainer does not is off."""
        # Environments have no thresholds: no stage is ever passed.
        stages = () if self.curriculum else (Stage(self.task(i), 1.0, 1, traffic=self.traffic) for i in range(len(self.environments)))
        curriculum = self.curriculum or Curriculum(self.town or "town3", self.weathers or ("ClearNoon",), 0.0, tuple(stages))
        observed = {"raw": ("raw", "raw_only"), "vector": ("vector", "vector"), "latent": ("both", "latent_and_raw")}
        inputs, observation = observed[self.observation]
        return {
            "algorithm": {"algo": self.algo, **asdict(new(self.algo, self.observation).params)},
            "inputs": inputs,
            **({"egos": self.egos} if self.egos > 1 else {}),
            "latent_gain": self.latent_gain,
            "seed": self.seed,
            "curriculum": asdict(curriculum),
            "env": {
                "world": "running",
                "observation": observation,
                "detector": self.found_by,
                "criteria": {"blocked_after": 4.0},
            },
            "encoder": "default" if self.observation == "latent" else "pooled",
            # The agents' files have it.
            "encoder_hash": "",
            "exploration": {
                "exploration_noise": exploration.DEVIATION.tolist(),
                "correlation": exploration.CORRELATION,
                "quiet_episodes": exploration.QUIET_EPISODES,
                "start_mean": exploration.START_MEAN.tolist(),
                "start_deviation": exploration.START_DEVIATION.tolist(),
            },
            "update_ratio": self.update_ratio,
            "batch_size": self.batch,
            "n_step": self.n_step,
            "reward_scale": 1.0,
            "near_ends": self.near_ends,
            "buffer": self.buffer,
            "learning_starts": self.learning_starts,
            "demonstrations": 0,
            "noisy_demonstrations": 0.0,
            "recorded": [],
            "pretrain": 0,
            "validation": {"every": 0},
            "checkpoint_every": self.checkpoint_every,
        }


class _Fleet:
    """The egos of one SUMO, while their episodes go on."""

    def __init__(self, settings: Settings, index: int, rng: np.random.Generator) -> None:
        self.envs, self.task = settings.make(index), settings.task(index)
        self.drawn: dict[str, Any] = {"stage": index} if settings.curriculum else {"environment": settings.environments[index]}
        self.now, self.info = self.envs.reset(seed=int(rng.integers(2**32)))
        self.noise = Noise(settings.egos, rng)
        #: Of the running episodes, by ego.
        self.returns, self.discounted = np.zeros(settings.egos), np.zeros(settings.egos)
        self.lengths = np.zeros(settings.egos, int)
        #: Where their last transitions began.
        self.trails: list[collections.deque[int]] = [collections.deque(maxlen=NEAR) for _ in range(settings.egos)]
        self.terms = {name: np.zeros(settings.egos) for name in TERMS}

    def note(
        self, driven: NDArray[np.bool_], rewards: NDArray[np.float64], began: NDArray[np.int64], gamma: float
    ) -> None:
        """Adds a tick of the egos that have ``driven`` one; ``began`` are the places where it began."""
        for i in np.flatnonzero(driven):
            self.trails[i].append(int(began[i]))
        rewards = np.where(driven, rewards, 0)
        self.returns += rewards
        self.discounted += gamma**self.lengths * rewards
        self.lengths += driven
        for name, sums in self.terms.items():
            sums += np.where(driven, self.info["reward_terms"][name], 0)

    def line(self, i: int, learns: bool) -> dict[str, Any]:
        """The log's line of ego ``i``'s episode, which has ended; the next one begins."""
        info = self.info
        line = {
            "by": "agent" if learns else "start",
            "task": self.task,
            **self.drawn,
            "charts/episodic_return": float(self.returns[i]),
            "charts/episodic_length": int(self.lengths[i]),
            "discounted_return": float(self.discounted[i]),
            "end": info["end"][i],
            "cause": info["cause"][i],
            "success": bool(info["success"][i]),
            "mean_speed": float(info["driven"][i] / (max(int(info["tick"][i]), 1) * _TICK)),
            "distance": float(info["driven"][i]),
            "reward": {name: float(sums[i]) for name, sums in self.terms.items()},
        }
        self.forget(i)
        return line

    def forget(self, i: int) -> None:
        """Ego ``i``'s episode is over."""
        self.trails[i].clear()
        for sums in (self.returns, self.discounted, self.lengths, *self.terms.values()):
            sums[i] = 0

    def places(self) -> NDArray[np.int64]:
        """Where the egos are."""
        return places.of(self.info["x"], self.info["y"], self.info["heading"])


class Collector:
    """Drives egos that share a SUMO by the newest actor that it is given; ``steps`` are those that the training had taken before."""

    def __init__(self, number: int, settings: Settings, steps: int = 0) -> None:
        prepare()
        self._number, self._settings, self._steps = number, settings, steps
        agent = new(settings.algo, settings.observation)
        self._actor, self._gamma = agent.actor, agent.params.gamma
        self._rng: np.random.Generator | None = None
        #: By the task's number. A SUMO waits while other tasks are driven.
        self._fleets: dict[int, _Fleet] = {}
        self._deaths = 0

    def drive(self, turn: int, weights: Weights, learns: bool, stage: int = 0) -> tuple[list[dict[str, Any]], list[Segment]]:
        """Drives ``settings.segment`` ticks of one task, at this stage of the curriculum; ``turn`` counts the calls. Before learning
        starts actions are random.

        Returns:
            The log's lines of the episodes that ended, and the segments.

        Raises:
            SumoError: SUMO does not start, again and again.
            Error: It died again and again.
        """
        settings = self._settings
        if self._rng is None:
            # After the loss of a process its successor drives other episodes, and so does a training that goes on.
            self._rng = np.random.default_rng([settings.seed, self._number, turn, self._steps])
        index = settings.choose(self._number, stage, self._rng)
        self._actor.load_state_dict({name: torch.tensor(values) for name, values in weights.items()})
        while True:
            try:
                if index not in self._fleets:
                    self._fleets[index] = _Fleet(settings, index, self._rng)
                return self._drive(self._fleets[index], learns)
            except SumoError:
                # It died where that ends no episode, such as between two.
                self._deaths += 1
                if self._deaths >= _PATIENCE:
                    raise
                if index in self._fleets:
                    self._fleets.pop(index).envs.close()

    def _drive(self, fleet: _Fleet, learns: bool) -> tuple[list[dict[str, Any]], list[Segment]]:
        settings = self._settings
        observations, before = [fleet.now], [np.array(trail, np.int64) for trail in fleet.trails]
        ticks: list[tuple[NDArray[Any], ...]] = []
        episodes: list[dict[str, Any]] = []
        died = False
        for _ in range(settings.segment):
            action, began = self._act(fleet, learns), fleet.places()
            fleet.now, reward, terminated, truncated, fleet.info = fleet.envs.step(action)
            info = fleet.info
            # Tick 0: its episode begins, or it waits for a free place. SUMO's death says nothing about driving.
            over = terminated | truncated
            lost = np.array([over[i] and info["end"][i] == "error" for i in range(settings.egos)])
            driven = (info["tick"] > 0) & ~lost
            died |= bool(lost.any())
            fleet.noise.reset(info["tick"] == 0)
            fleet.note(driven, reward, began, self._gamma)
            for i in np.flatnonzero(over):
                if lost[i]:
                    fleet.forget(int(i))
                else:
                    episodes.append(fleet.line(int(i), learns))
            observations.append(fleet.now)
            ticks.append((action, reward, driven, terminated, began))
        self._deaths = self._deaths + 1 if died else 0
        if self._deaths >= _PATIENCE:
            raise Error(f"SUMO died in {_PATIENCE} segments in a row")
        actions, rewards, valid, ended, began = (np.stack(part) for part in zip(*ticks))
        return episodes, list(segments(np.stack(observations), actions, rewards, valid, ended, began, before))

    def _act(self, fleet: _Fleet, learns: bool) -> NDArray[np.float32]:
        fleet.noise.advance()
        if not learns:
            action = fleet.noise.start()
        else:
            with torch.no_grad():
                action = self._actor.explore(self._actor.scaled(torch.from_numpy(fleet.now)), fleet.noise).numpy()
        return np.clip(action, LOW.numpy(), HIGH.numpy())

    def close(self) -> None:
        """Ends its SUMOs."""
        for fleet in self._fleets.values():
            fleet.envs.close()


def segments(
    observations: NDArray[np.float32],
    actions: NDArray[np.float32],
    rewards: NDArray[np.float64],
    valid: NDArray[np.bool_],
    terminated: NDArray[np.bool_],
    began: NDArray[np.int64],
    before: Sequence[NDArray[np.int64]],
) -> Iterator[Segment]:
    """The segments of T ticks of n egos: observations (T + 1, n, D), actions (T, n, 3), the rest (T, n); ``began`` are places, ``before`` those of
    each ego's running episode before these ticks. An ego's transitions that are not valid, such as the tick that begins its next episode,
    part its segments."""
    for ego in range(valid.shape[1]):
        borders = np.flatnonzero(np.diff(valid[:, ego], prepend=False, append=False))
        for begin, end in borders.reshape(-1, 2):
            over = bool(terminated[end - 1, ego])
            lead = began[begin:end, ego] if begin else np.concatenate([before[ego], began[:end, ego]])
            yield Segment(
                observations[begin : end + 1, ego],
                actions[begin:end, ego],
                rewards[begin:end, ego].astype(np.float32),
                over,
                began[begin:end, ego],
                lead[-NEAR:] if over else None,
            )


@dataclass(frozen=True)
class Published:
    """A learner's state as others need it."""

    #: Transitions that it has taken.
    steps: int
    #: The weights' version.
    updates: int
    weights: Weights
    #: In the curriculum.
    stage: int
    #: Entries of the buffer.
    buffer: int
    #: Wall time of the training so far, of all its learners.
    hours: float
    #: Means since the last.
    losses: dict[str, float] = field(default_factory=dict)
    #: Stages that were left since the last, as the log has them.
    passed: list[dict[str, Any]] = field(default_factory=list)


class Learner:
    """Learns from segments; ``checkpoint`` is what :meth:`save` gave."""

    def __init__(self, settings: Settings, checkpoint: bytes | None = None) -> None:
        prepare()
        torch.manual_seed(settings.seed)
        self._settings = settings
        self._agent = new(settings.algo, settings.observation)
        self._buffer = ReplayBuffer(settings.buffer, latent_size(settings.observation) + RAW)
        self._rng = np.random.default_rng(settings.seed)
        self._steps, self._due = 0, 0.0
        self._progress = Progress()
        #: When this learner's time began, as if it had learned all before too (s).
        self._began = time.monotonic()
        if checkpoint is not None:
            self._load(checkpoint)

    def published(self) -> Published:
        """The newest weights."""
        weights = {name: tensor.numpy().copy() for name, tensor in self._agent.actor.state_dict().items()}
        hours = (time.monotonic() - self._began) / 3600
        return Published(self._steps, self._agent.updates, weights, self._progress.stage, len(self._buffer), hours)

    def take(self, new_ones: list[Segment], episodes: Sequence[dict[str, Any]] = ()) -> Published:
        """Adds segments to the buffer, makes the updates that are due, and notes how the episodes that ended went.

        Raises:
            Error: A loss is not a number.
        """
        for segment in new_ones:
            self._buffer.push(segment)
        count = sum(len(segment.actions) for segment in new_ones)
        before, self._steps = self._steps, self._steps + count
        losses = self._learn(before)
        return replace(self.published(), losses=losses, passed=self._note(episodes))

    def _note(self, episodes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        if self._settings.curriculum is None:
            return []
        lines = []
        for episode in episodes:
            passed = self._progress.note(
                self._settings.curriculum, episode["stage"], episode["charts/episodic_length"], episode["success"]
            )
            if passed is not None:
                hours = (time.monotonic() - self._began) / 3600
                lines.append({"stage": passed.stage, "threshold": passed.threshold, "step": self._steps, "hours": hours})
        return lines

    def _learn(self, before: int) -> dict[str, float]:
        """Makes the updates that are due since the learner had taken ``before`` transitions; means of the losses."""
        settings, agent = self._settings, self._agent
        learned = self._steps - max(before, settings.learning_starts)
        if learned <= 0:
            return {}
        if agent.updates == 0 and settings.observation == "latent":
            # On the first experience, and part of the actor from then on. All other numbers are scaled by definition.
            agent.actor.measure(self._buffer.observations(20_000), settings.latent_gain)
        self._due += learned * settings.update_ratio
        sums: dict[str, list[float]] = {}
        while self._due >= 1:
            self._due -= 1
            batch = self._buffer.sample(self._rng, settings.batch, settings.n_step, agent.params.gamma, settings.near_ends)
            scaled = agent.actor.scaled
            batch = batch._replace(observation=scaled(batch.observation), next_observation=scaled(batch.next_observation))
            for name, loss in agent.update(batch).items():
                sums.setdefault(name, []).append(loss)
        losses = {name: float(np.mean(values)) for name, values in sums.items()}
        for name, loss in losses.items():
            if not np.isfinite(loss):
                raise Error(f"{name} is {loss} after {agent.updates} updates: training stops, and the last checkpoint stays")
        return losses

    def save(self) -> bytes:
        """A checkpoint: networks, optimisers, random generators and buffer."""
        state = {
            "version": _native.VERSION,
            "settings": asdict(self._settings),
            "networks": self._agent.state_dict(),
            "optimizers": {name: optimizer.state_dict() for name, optimizer in self._agent.optimizers.items()},
            "buffer": self._buffer.state(),
            "rng": self._rng.bit_generator.state,
            "torch_rng": torch.get_rng_state(),
            "steps": self._steps,
            "updates": self._agent.updates,
            "due": self._due,
            "progress": asdict(self._progress),
            "seconds": time.monotonic() - self._began,
        }
        file = io.BytesIO()
        torch.save(state, file)
        return file.getvalue()

    def _load(self, checkpoint: bytes) -> None:
        state = _read(checkpoint)
        self._agent.load_state_dict(state["networks"])
        for name, optimizer in self._agent.optimizers.items():
            optimizer.load_state_dict(state["optimizers"][name])
        self._buffer.load(state["buffer"])
        self._rng.bit_generator.state = state["rng"]
        torch.set_rng_state(state["torch_rng"])
        self._steps, self._agent.updates, self._due = state["steps"], state["updates"], state["due"]
        self._progress = Progress(**state["progress"])
        self._began = time.monotonic() - state["seconds"]


def _read(checkpoint: bytes) -> dict[str, Any]:
    # Numbers and tensors only: a checkpoint runs no code.
    state: dict[str, Any] = torch.load(io.BytesIO(checkpoint), weights_only=True)
    return state


def steps_of(checkpoint: bytes) -> int:
    """The transitions that a checkpoint's learner has taken.

    Raises:
        Exception: It is damaged.
    """
    return int(_read(checkpoint)["steps"])


def write_agent(checkpoint: bytes, settings: Settings, path: str | os.PathLike[str]) -> None:
    """Writes a checkpoint's actor as an agent's file."""
    state = _read(checkpoint)
    agent = new(settings.algo, settings.observation)
    agent.load_state_dict(state["networks"])
    layers = [[part.detach().numpy() for part in (layer.weight, layer.bias)] for layer in agent.actor.linears()]
    save_agent(
        path,
        layers,
        algo=settings.algo,
        observation=settings.observation,
        scale=(agent.actor.offset.numpy(), agent.actor.factor.numpy()),
        detector=settings.found_by,
        steps=state["steps"],
        updates=state["updates"],
        seed=settings.seed,
        params=asdict(agent.params),
        config=settings.config(),
    )
