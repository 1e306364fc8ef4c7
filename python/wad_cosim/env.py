"""One environment."""

from __future__ import annotations

import os
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from . import _native, info as infos
from ._native import InputError
from .observations import Arrays
from .setup import Setup


class DrivingEnv(gymnasium.Env[Any, Any]):
    """An ego vehicle in SUMO's traffic, one tick (167 ms) a step.

    Args:
        suite: A bundled benchmark whose task this is; the ids set it.
        task: ``straight``, ``one_turn``, ``roundabout``, ``obstacle``, ``cross``, ``composite`` or ``navigation``, with
            ``suite`` the suite's task; the ids set it. None: the scenario's.
        town: A bundled town or scenario by name, a ``.sumocfg``, a ``.net.xml(.gz)``, or a folder with a scenario.
            Default town3, or the condition's.
        condition: ``training``, ``development`` or ``test``: the benchmark's town, weathers and routes.
        traffic: ``empty``, ``regular``, ``dense``, ``as-is`` (the configuration's own), or (vehicles, pedestrians). Default: the
            task's own.
        weather: A name, or several of which each episode draws one from its seed. Default ClearNoon, or the
            condition's.
        observation: ``raw`` (15 numbers), ``vector`` (187 numbers of the world round the ego), ``latent`` (200
            numbers of the transformed image, and the raw states), ``image`` (the front camera, 512x512x3), ``transformed``
            (128x128x3), ``dict`` (raw and image by name), or several names in a list.
        action: ``continuous`` (steering -1 to 1, left positive; throttle 0 to 1; brake 0 to 1), ``pedal`` (steering, and a
            pedal that brakes below 0), ``discrete`` (:data:`wad_cosim.DISCRETE_ACTIONS`), or a table (n, 3).
        detector: What finds road users in the picture, as the command line's ``--detector``. Default ``truth`` for ``latent`` and
            ``transformed``, else ``outlines``, which draws nothing.
        encoder: What makes the latent: a bundled encoder's name or a file of ``wad-cosim train encoder``.
        reward: ``wad`` (docs/reward.md), its constants by name, or a function of (observation, action, info).
        mode: ``evaluation`` (a new SUMO for each episode, which depends on its seed alone) or ``training`` (traffic runs
            on between episodes, and standing without a reason ends an episode after 4 s, not 90).
        tick_limit: Ticks until an episode is truncated. Default: the task's own.
        options: More of the simulator's options, as docs/python.md lists them.
        record: A ``.mcap`` file for Foxglove and Rerun with picture, boxes (of the detector; with ``vector`` those of ``truth``),
            map, traffic, pose and reward of every tick; it is complete after ``close``. A picture a tick takes time. Of several
            environments each has its own, ``drive-0.mcap`` and so on.
        render_mode: ``rgb_array`` (the front camera's picture, drawn when asked for) or ``human`` (SUMO's own window).

    Raises:
        InputError: An argument is wrong.
        SumoError: No SUMO is found.
    """

    # SUMO's window needs a display.
    metadata = {"render_modes": ["rgb_array", *(["human"] if os.environ.get("DISPLAY") else [])], "render_fps": 6}

    def __init__(self, **kwargs: Any) -> None:
        setup = Setup(**kwargs)
        if kwargs.get("egos", 1) != 1:
            raise InputError("egos: one environment is one ego; several are gymnasium.make_vec's")
        self._setup = setup
        self._arrays = Arrays(setup.observation, 1, setup.camera)
        self._native = _native.Environments(1, setup.text, self._arrays.native(), None, "disabled")
        self.observation_space = self._arrays.space
        self.action_space = setup.action_space
        self.render_mode = setup.render_mode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode. Everything random in it comes from ``seed``; without one it is drawn.

        Args:
            seed: The episode's seed, the command line's ``--seed``.
            options: ``{"route": n}`` drives the n-th route of a benchmark.

        Returns:
            The observation, and facts (:mod:`wad_cosim.info`).

        Raises:
            InputError: The task has no place in this town.
            SumoError: SUMO did not start.
        """
        super().reset(seed=seed)
        chosen = int(self.np_random.integers(2**63)) if seed is None else int(seed) % 2**64
        self._native.reset([chosen], route_of(options))
        return self._arrays.one(0), infos.of(self._arrays.numbers[0])

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drives one tick.

        Returns:
            The observation, the reward, ``terminated`` (the ego's own driving ended the episode: the next state is worth
            0), ``truncated`` (arrival, the clock, or SUMO's death: the next state still has a value), and facts. After
            SUMO's death ``info["end"]`` is ``error``: drop that transition and reset.

        Raises:
            InputError: The action has another shape or type, or is not finite.
            Error: No episode is running, or the environment is closed.
        """
        parts, reward, terminated, truncated, info = self._native.step_one(self._setup.controls([action], 1))
        observation = parts if self._arrays.named else parts[self._arrays.parts[0]]
        if self._setup.reward is not None:
            reward = float(self._setup.reward(observation, action, info))
        return observation, reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override, unused-ignore]
        """The front camera's picture, (height, width, 3), with ``render_mode="rgb_array"``."""
        return self._native.picture(0) if self.render_mode == "rgb_array" else None

    def expert_action(self) -> NDArray[np.float32]:
        """The rule-based expert's steering, throttle and brake for this tick. It sees the whole world and has a
        memory: ask it at every tick of an episode that it drives, and once a tick."""
        return np.array(self._native.expert()[0], dtype=np.float32)

    @property
    def sumo_pid(self) -> int | None:
        """Id of SUMO's process."""
        return self._native.sumos()[0]

    def close(self) -> None:
        """Ends SUMO. A closed environment cannot be used again."""
        self._native.close()


def route_of(options: dict[str, Any] | None) -> int | None:
    """The route that ``options`` of a reset names."""
    unknown = set(options or ()) - {"route"}
    if unknown:
        raise InputError(f"options of reset: expected route, found {', '.join(sorted(map(str, unknown)))}")
    return (options or {}).get("route")
