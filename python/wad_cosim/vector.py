"""Many environments at once, each with its SUMO on a thread of its own."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from . import _native, info as infos
from ._native import InputError
from .env import DrivingEnv, route_of
from .observations import Arrays
from .setup import Setup

_MODES = {
    AutoresetMode.NEXT_STEP: "next_step",
    AutoresetMode.SAME_STEP: "same_step",
    AutoresetMode.DISABLED: "disabled",
}


class DrivingVectorEnv(VectorEnv[Any, Any, NDArray[Any]]):
    """``num_envs`` environments that step together: ``gymnasium.make_vec("wad_cosim/Straight-v0", num_envs=4)``.

    Equal seeds give the arrays of ``gymnasium.vector.SyncVectorEnv``, in less time.

    Args:
        num_envs: Their number.
        autoreset_mode: What happens after an episode's end, as in Gymnasium.
        copy: Whether ``reset`` and ``step`` return copies; False: the arrays are written again by the next step.
        egos: Egos in each SUMO; ``num_envs`` is a multiple of it. They see each other and collide with each other.
            Several are many times faster than as many SUMOs: their episodes depend on the seed and on all actions. With
            NEXT_STEP an ego that finds no free place waits; with DISABLED an ego whose episode ended leaves the road until
            all are reset together. They have no SAME_STEP.
        **kwargs: As :class:`wad_cosim.DrivingEnv`.
    """

    metadata: dict[str, Any] = {**DrivingEnv.metadata, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        **kwargs: Any,
    ) -> None:
        if num_envs < 1:
            raise InputError(f"num_envs={num_envs}: expected 1 or more")
        mode = autoreset_mode if isinstance(autoreset_mode, AutoresetMode) else AutoresetMode(autoreset_mode)
        setup = Setup(**kwargs)
        self._setup = setup
        self._mode = mode
        self._copy = copy
        self._arrays = Arrays(setup.observation, num_envs, setup.camera)
        self._last = Arrays(setup.observation, num_envs, setup.camera) if mode == AutoresetMode.SAME_STEP else None
        last = self._last.native() if self._last else None
        self._sumos = _native.Environments(num_envs, setup.text, self._arrays.native(), last, _MODES[mode])
        self.num_envs = num_envs
        self.metadata = {**type(self).metadata, "autoreset_mode": mode}
        self.render_mode = setup.render_mode
        self.single_observation_space = self._arrays.space
        self.single_action_space = setup.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all = np.ones(num_envs, np.bool_)
        self._generators = [seeding.np_random()[0] for _ in range(num_envs)]
        # The seeds of the next episodes, drawn before they are needed.
        self._seeds = [self._drawn(i) for i in range(num_envs)]

    def _drawn(self, index: int) -> int:
        return int(self._generators[index].integers(2**63))

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begins episodes, of all environments or of those in ``options["reset_mask"]``; see :class:`DrivingEnv`."""
        options = dict(options or {})
        chosen = options.pop("reset_mask", self._all)
        if not isinstance(chosen, np.ndarray) or chosen.dtype != np.bool_ or chosen.shape != (self.num_envs,):
            raise InputError(f"options['reset_mask']: expected an array of {self.num_envs} bools, found {chosen!r}")
        if not chosen.any():
            raise InputError("options['reset_mask']: expected an environment or more, found none")
        if seed is None or isinstance(seed, (int, np.integer)):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise InputError(f"seed: expected {self.num_envs} seeds, found {len(seeds)}")
        wanted: list[int | None] = [None] * self.num_envs
        for i in np.flatnonzero(chosen):
            own = seeds[i]
            if own is None:
                wanted[i] = self._seeds[i]
            else:
                self._generators[i] = seeding.np_random(own)[0]
                wanted[i] = own % 2**64
            self._seeds[i] = self._drawn(int(i))
        self._sumos.reset(wanted, route_of(options))
        return self._arrays.all(self._copy), infos.of_all(self._arrays.numbers, chosen)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Drives one tick of every environment."""
        news = self._sumos.step(self._setup.controls(actions, self.num_envs), self._seeds)
        numbers = self._arrays.numbers
        rewards = numbers[:, infos.REWARD].copy()
        terminated = numbers[:, infos.TERMINATED] != 0
        truncated = numbers[:, infos.TRUNCATED] != 0
        info = infos.of_all(numbers, self._all)
        for i, began, events, ending in news:
            details: dict[str, Any] = {}
            infos.add_news(details, events, ending)
            if began:
                self._seeds[i] = self._drawn(i)
                if ending is not None and self._last is not None:
                    details = {**infos.of(self._last.numbers[i]), **details}
                    details = {"final_obs": self._last.one(i), "final_info": details}
            info = self._add_info(info, details, i)
        observations = self._arrays.all(self._copy)
        if self._setup.reward is not None:
            self._rewarded(rewards, actions, info, news)
        return observations, rewards, terminated, truncated, info

    def _rewarded(self, rewards: NDArray[np.float64], actions: Any, info: dict[str, Any], news: list[Any]) -> None:
        """A reward of Python's is computed for each environment in turn."""
        assert self._setup.reward is not None
        told = {i: (events, ending) for i, _, events, ending in news}
        for i in range(self.num_envs):
            events, ending = told.get(i, ([], None))
            if info["tick"][i] == 0 and ending is None:
                # Its episode begins, or it has none.
                continue
            arrays = self._arrays if ending is None or self._last is None else self._last
            own = infos.of(arrays.numbers[i])
            infos.add_news(own, events, ending)
            rewards[i] = self._setup.reward(arrays.one(i), actions[i], own)

    def render(self) -> tuple[NDArray[np.uint8] | None, ...]:  # type: ignore[override]
        """The front cameras' pictures, with ``render_mode="rgb_array"``."""
        if self.render_mode != "rgb_array":
            return (None,) * self.num_envs
        return tuple(self._sumos.picture(i) for i in range(self.num_envs))

    def expert_actions(self) -> NDArray[np.float32]:
        """The rule-based experts' actions for this tick, (num_envs, 3); see :meth:`DrivingEnv.expert_action`. Zeros for an
        environment whose next step begins an episode and ignores the action."""
        return np.array(self._sumos.expert(), dtype=np.float32)

    @property
    def sumo_pids(self) -> list[int | None]:
        """Ids of the SUMO processes."""
        return self._sumos.sumos()

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the SUMOs."""
        # Gymnasium 1.2 closes what could not be made, too.
        if hasattr(self, "_sumos"):
            self._sumos.close()


