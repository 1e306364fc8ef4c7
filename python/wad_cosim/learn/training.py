"""A training's two halves, wherever they run: :class:`Collector` drives egos and cuts what they do into segments, :class:`Learner` takes
segments and publishes weights by version."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from .. import _native
from .._native import Error, InputError
from ..evaluation import save_agent
from ..vector import DrivingVectorEnv
from . import ALGORITHMS, new, prepare
from .exploration import Noise
from .networks import HIGH, LOW, RAW, latent_size
from .replay import ReplayBuffer, Segment

#: An actor's numbers by name.
Weights = dict[str, NDArray[np.float32]]

#: Segments in a row in which SUMO died, after which a collector gives up.
_PATIENCE = 5


@dataclass(frozen=True)
class Settings:
    """Everything that changes what is learned; saved as a training's config.json."""

    #: td3 (WAD-T) or sac (WAD-S).
    algo: str = "td3"
    #: The environments' ids; collectors have them in turns.
    environments: tuple[str, ...] = ("wad_cosim/Straight-v0",)
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
    #: Transitions that are kept.
    buffer: int = 200_000
    #: Deviation to which the latent, or the surroundings, are scaled.
    latent_gain: float = 0.1
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
        return self.detector or ("truth" if self.observation == "latent" else "outlines")

    def make(self, number: int) -> DrivingVectorEnv:
        """Collector ``number``'s egos in one SUMO."""
        kwargs = dict(gymnasium.spec(self.environments[number % len(self.environments)]).kwargs)
        given = {"town": self.town, "traffic": self.traffic, "weather": self.weathers or None}
        kwargs.update({name: value for name, value in given.items() if value is not None})
        kwargs.update(mode="training", observation=self.observation, detector=self.found_by, egos=self.egos)
        return DrivingVectorEnv(self.egos, **kwargs)


@dataclass(frozen=True)
class Driven:
    """What a collector says beside its segments."""

    #: Of its process: node's name and number; a collector that was started again has another.
    process: int
    #: Lines of the training's log, of episodes that ended.
    episodes: list[dict[str, Any]]


class Collector:
    """Drives egos that share a SUMO by the newest actor that it is given."""

    def __init__(self, number: int, settings: Settings) -> None:
        prepare()
        self._number, self._settings = number, settings
        self._actor = new(settings.algo, settings.observation).actor
        self._envs: DrivingVectorEnv | None = None
        self._deaths = 0

    def drive(self, turn: int, weights: Weights, learns: bool) -> tuple[Driven, list[Segment]]:
        """Drives ``settings.segment`` ticks; ``turn`` counts them. Before learning starts actions are random.

        Raises:
            SumoError: SUMO does not start.
            Error: It died again and again.
        """
        settings = self._settings
        if self._envs is None:
            # After the loss of a process its successor drives other episodes.
            self._rng = np.random.default_rng([settings.seed, self._number, turn])
            self._envs = settings.make(self._number)
            self._now, _ = self._envs.reset(seed=int(self._rng.integers(2**32)))
            self._noise = Noise(settings.egos, self._rng)
            self._returns, self._lengths = np.zeros(settings.egos), np.zeros(settings.egos, int)
        self._actor.load_state_dict({name: torch.tensor(values) for name, values in weights.items()})
        observations = [self._now]
        ticks: list[tuple[NDArray[Any], ...]] = []
        episodes: list[dict[str, Any]] = []
        died = False
        for _ in range(settings.segment):
            action = self._act(learns)
            self._now, reward, terminated, truncated, info = self._envs.step(action)
            # Tick 0: its episode begins, or it waits for a free place. SUMO's death says nothing about driving.
            over = terminated | truncated
            lost = np.array([over[i] and info["end"][i] == "error" for i in range(settings.egos)])
            driven = (info["tick"] > 0) & ~lost
            died |= bool(lost.any())
            self._noise.reset(info["tick"] == 0)
            self._returns += np.where(driven, reward, 0)
            self._lengths += driven
            for i in np.flatnonzero(over):
                if not lost[i]:
                    episodes.append(self._line(int(i), info, learns))
                self._returns[i], self._lengths[i] = 0, 0
            observations.append(self._now)
            ticks.append((action, reward, driven, terminated))
        self._deaths = self._deaths + 1 if died else 0
        if self._deaths == _PATIENCE:
            raise Error(f"SUMO died in {_PATIENCE} segments in a row")
        actions, rewards, valid, ended = (np.stack(part) for part in zip(*ticks))
        found = segments(np.stack(observations), actions, rewards, valid, ended)
        return Driven(os.getpid(), episodes), list(found)

    def _act(self, learns: bool) -> NDArray[np.float32]:
        self._noise.advance()
        if not learns:
            action = self._noise.start()
        else:
            with torch.no_grad():
                action = self._actor.explore(self._actor.scaled(torch.from_numpy(self._now)), self._noise).numpy()
        return np.clip(action, LOW.numpy(), HIGH.numpy())

    def _line(self, i: int, info: dict[str, Any], learns: bool) -> dict[str, Any]:
        return {
            "by": "agent" if learns else "start",
            "environment": self._settings.environments[self._number % len(self._settings.environments)],
            "charts/episodic_return": float(self._returns[i]),
            "charts/episodic_length": int(self._lengths[i]),
            "end": info["end"][i],
            "cause": info["cause"][i],
            "success": bool(info["success"][i]),
            "distance": float(info["driven"][i]),
        }

    def close(self) -> None:
        """Ends its SUMO."""
        if self._envs is not None:
            self._envs.close()


def segments(
    observations: NDArray[np.float32],
    actions: NDArray[np.float32],
    rewards: NDArray[np.float64],
    valid: NDArray[np.bool_],
    terminated: NDArray[np.bool_],
) -> Iterator[Segment]:
    """The segments of T ticks of n egos: observations (T + 1, n, D), actions (T, n, 3), the rest (T, n). An ego's transitions
    that are not valid, such as the tick that begins its next episode, part its segments."""
    for ego in range(valid.shape[1]):
        borders = np.flatnonzero(np.diff(valid[:, ego], prepend=False, append=False))
        for begin, end in borders.reshape(-1, 2):
            yield Segment(
                observations[begin : end + 1, ego],
                actions[begin:end, ego],
                rewards[begin:end, ego].astype(np.float32),
                bool(terminated[end - 1, ego]),
            )


@dataclass(frozen=True)
class Published:
    """A learner's state as others need it."""

    #: Transitions that it has taken.
    steps: int
    #: The weights' version.
    updates: int
    weights: Weights
    #: Means since the last.
    losses: dict[str, float]


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
        if checkpoint is not None:
            self._load(checkpoint)

    def published(self) -> Published:
        """The newest weights."""
        weights = {name: tensor.numpy().copy() for name, tensor in self._agent.actor.state_dict().items()}
        return Published(self._steps, self._agent.updates, weights, {})

    def take(self, new_ones: list[Segment]) -> Published:
        """Adds segments to the buffer, and makes the updates that are due.

        Raises:
            Error: A loss is not a number.
        """
        settings, agent = self._settings, self._agent
        for segment in new_ones:
            self._buffer.push(segment)
        count = sum(len(segment.actions) for segment in new_ones)
        before, self._steps = self._steps, self._steps + count
        learned = self._steps - max(before, settings.learning_starts)
        if learned <= 0:
            return self.published()
        if agent.updates == 0:
            # On the first experience, and part of the actor from then on.
            agent.actor.measure(self._buffer.observations(20_000), settings.latent_gain)
        self._due += learned * settings.update_ratio
        sums: dict[str, list[float]] = {}
        while self._due >= 1:
            self._due -= 1
            batch = self._buffer.sample(self._rng, settings.batch, settings.n_step, agent.params.gamma)
            scaled = agent.actor.scaled
            batch = batch._replace(observation=scaled(batch.observation), next_observation=scaled(batch.next_observation))
            for name, loss in agent.update(batch).items():
                sums.setdefault(name, []).append(loss)
        losses = {name: float(np.mean(values)) for name, values in sums.items()}
        for name, loss in losses.items():
            if not np.isfinite(loss):
                raise Error(f"{name} is {loss} after {agent.updates} updates: training stops, and the last checkpoint stays")
        state = self.published()
        return Published(state.steps, state.updates, state.weights, losses)

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
        config=asdict(settings),
    )
