"""Stable-Baselines3: it does not take Gymnasium's vector environments, so here is its own form of them.

    from stable_baselines3 import SAC
    from wad_cosim.sb3 import DrivingVecEnv

    env = DrivingVecEnv("wad_cosim/Straight-v0", 4, action="pedal", mode="training")
    SAC("MlpPolicy", env).learn(25_000)

It needs the package stable-baselines3.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from .vector import DrivingVectorEnv


class DrivingVecEnv(VecEnv):
    """``n_envs`` environments of an id for Stable-Baselines3, each with its SUMO on a thread of its own.

    The ``infos`` of a step are empty but for episodes that ended: ``terminal_observation``, ``TimeLimit.truncated``,
    ``is_success`` (Stable-Baselines3 logs its mean), ``end``, ``cause``, ``route_done`` and ``episode`` (return ``r`` and length ``l``).

    Args:
        id: One of :func:`wad_cosim.ids`.
        n_envs: Their number.
        **kwargs: As :class:`wad_cosim.DrivingEnv`.
    """

    def __init__(self, id: str, n_envs: int = 1, **kwargs: Any) -> None:
        merged = {**gymnasium.spec(id).kwargs, **kwargs}
        self.envs = DrivingVectorEnv(n_envs, autoreset_mode=AutoresetMode.SAME_STEP, **merged)
        self.render_mode = self.envs.render_mode
        super().__init__(n_envs, self.envs.single_observation_space, self.envs.single_action_space)
        self._actions: NDArray[Any] | None = None
        self._returns = np.zeros(n_envs)
        self._lengths = np.zeros(n_envs, dtype=int)

    def reset(self) -> Any:
        """Begins an episode of each environment, with the seeds of :meth:`seed` if it was called."""
        seeds: Any = None if all(seed is None for seed in self._seeds) else list(self._seeds)
        observations, _ = self.envs.reset(seed=seeds)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0
        self._lengths[:] = 0
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Takes the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Drives one tick."""
        observations, rewards, terminated, truncated, found = self.envs.step(self._actions)
        over = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(over):
            final = found["final_info"]
            infos[i] = {
                "terminal_observation": found["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i]),
                "is_success": bool(final["success"][i]),
                "end": final["end"][i],
                "cause": final["cause"][i],
                "route_done": float(final["route_done"][i]),
                "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
            }
        self._returns[over] = 0
        self._lengths[over] = 0
        return observations, rewards.astype(np.float32), over, infos

    def close(self) -> None:
        """Ends the SUMOs."""
        self.envs.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """The front cameras' pictures."""
        return self.envs.render()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute, the same for all."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not possible: the environments are no Python objects."""
        raise NotImplementedError("the environments are no Python objects: give arguments to DrivingVecEnv instead")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Not possible: the environments are no Python objects."""
        raise NotImplementedError("the environments are no Python objects: give arguments to DrivingVecEnv instead")

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """False for each."""
        return [False] * len(list(self._get_indices(indices)))
