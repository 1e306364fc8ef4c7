"""PettingZoo: several egos in one SUMO, each an agent.

    from wad_cosim.pettingzoo import DrivingParallelEnv

    env = DrivingParallelEnv("wad_cosim/Composite-v0", egos=8, observation="vector", mode="training")
    observations, infos = env.reset(seed=1)
    while env.agents:
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(actions)

It needs the package pettingzoo.
"""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from . import _native, info as infos
from ._native import InputError
from .observations import Arrays
from .setup import Setup


class DrivingParallelEnv(ParallelEnv[str, Any, Any]):
    """``egos`` vehicles in one SUMO, which see each other and collide with each other.

    An agent whose episode ends is gone from ``agents`` and off the road; ``reset`` begins an episode of all. The episodes
    depend on the seed and on all actions.

    Args:
        id: One of :func:`wad_cosim.ids`.
        egos: Their number; the agents are ``ego_0``, ``ego_1`` and so on.
        **kwargs: As :class:`wad_cosim.DrivingEnv`. Several egos have neither pictures nor a benchmark's routes.

    Raises:
        InputError: An argument is wrong.
        SumoError: No SUMO is found.
    """

    metadata: dict[str, Any] = {"name": "wad_cosim_v0", "render_modes": []}

    def __init__(self, id: str, egos: int = 2, **kwargs: Any) -> None:
        setup = Setup(**{**gymnasium.spec(id).kwargs, **kwargs, "egos": egos})
        self._setup = setup
        self._arrays = Arrays(setup.observation, egos, setup.camera)
        self._native = _native.Environments(egos, setup.text, self._arrays.native(), None, "disabled")
        self.render_mode = setup.render_mode
        self.possible_agents = [f"ego_{i}" for i in range(egos)]
        self.agents: list[str] = []
        self._generator = seeding.np_random()[0]
        # A space of its own for each: they are seeded one by one.
        self.observation_spaces = {agent: copy.deepcopy(self._arrays.space) for agent in self.possible_agents}
        self.action_spaces = {agent: copy.deepcopy(setup.action_space) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """An agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """An agent's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Begins an episode of every agent; everything random in them comes from ``seed``. ``options`` are not used.

        Returns:
            Observations and facts (:mod:`wad_cosim.info`) by agent.
        """
        if seed is not None:
            self._generator = seeding.np_random(seed)[0]
        chosen = int(self._generator.integers(2**63)) if seed is None else int(seed) % 2**64
        self.agents = []
        self._native.reset([chosen] * len(self.possible_agents))
        self.agents = list(self.possible_agents)
        return self._observations(), {agent: self._info(i) for i, agent in enumerate(self.agents)}

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[
        dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:
        """Drives one tick of every agent in ``agents``; each needs an action.

        Returns:
            Observations, rewards, terminations, truncations and facts of the agents that drove.

        Raises:
            InputError: An action is missing, or has another shape or type, or is not finite.
        """
        if not self.agents:
            return {}, {}, {}, {}, {}
        missing = [agent for agent in self.agents if agent not in actions]
        if missing:
            raise InputError(f"actions: expected one for each of {', '.join(self.agents)}; {', '.join(missing)} missing")
        drove = {agent: i for i, agent in enumerate(self.possible_agents) if agent in set(self.agents)}
        # Those that are gone get what another does; nobody reads it.
        some = actions[self.agents[0]]
        rows = [actions[agent] if agent in drove else some for agent in self.possible_agents]
        news = self._native.step(self._setup.controls(rows, len(rows)), [0] * len(rows))
        told = {i: (events, ending) for i, _, events, ending in news}
        observations = {agent: self._arrays.one(i) for agent, i in drove.items()}
        rewards, found = {}, {}
        for agent, i in drove.items():
            found[agent] = self._info(i)
            infos.add_news(found[agent], *told.get(i, ([], None)))
            rewards[agent] = float(self._arrays.numbers[i, infos.REWARD])
            if self._setup.reward is not None:
                rewards[agent] = float(self._setup.reward(observations[agent], actions[agent], found[agent]))
        terminations = {agent: bool(self._arrays.numbers[i, infos.TERMINATED]) for agent, i in drove.items()}
        truncations = {agent: bool(self._arrays.numbers[i, infos.TRUNCATED]) for agent, i in drove.items()}
        self.agents = [agent for agent in self.agents if not (terminations[agent] or truncations[agent])]
        return observations, rewards, terminations, truncations, found

    def _observations(self) -> dict[str, Any]:
        return {agent: self._arrays.one(i) for i, agent in enumerate(self.possible_agents)}

    def _info(self, index: int) -> dict[str, Any]:
        return infos.of(self._arrays.numbers[index])

    @property
    def sumo_pid(self) -> int | None:
        """Id of SUMO's process."""
        return self._native.sumos()[0]

    def close(self) -> None:
        """Ends SUMO. A closed environment cannot be used again."""
        self.agents = []
        self._native.close()
