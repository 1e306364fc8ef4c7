"""The arguments of an environment, checked and turned into what the simulator reads."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from . import actions, observations, registry
from ._native import InputError

RewardFunction = Callable[[Any, Any, dict[str, Any]], float]


class Setup:
    """See :class:`wad_cosim.DrivingEnv` for the arguments."""

    def __init__(
        self,
        *,
        suite: str | None = None,
        task: str | None = None,
        town: str | os.PathLike[str] | None = None,
        condition: str | None = None,
        traffic: str | tuple[int, int] | None = None,
        weather: str | Iterable[str] | None = None,
        observation: str | Iterable[str] = "raw",
        action: Any = "continuous",
        detector: str | None = None,
        encoder: str | os.PathLike[str] = "default",
        reward: str | Mapping[str, float] | RewardFunction = "wad",
        mode: str = "evaluation",
        tick_limit: int | None = None,
        options: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        record: str | os.PathLike[str] | None = None,
        egos: int = 1,
    ) -> None:
        if render_mode not in (None, "rgb_array", "human"):
            raise InputError(f"render_mode={render_mode!r}: expected None, 'rgb_array' or 'human' (SUMO's own window)")
        self.observation = observation if isinstance(observation, str) else tuple(observation)
        parts = observations.parts_of(self.observation)
        merged: dict[str, Any] = {"world": "fresh", "detector": detector or observations.found_by(self.observation)}
        made: dict[str, Any] = {
            "town": None,
            "task": task,
            "traffic": None,
            "weathers": [],
            "tick_limit": None,
            "endless": False,
            "routes": None,
            "egos": egos,
            "encoder": os.fspath(encoder),
        }
        if suite is not None:
            _of_suite(suite, task, condition, made, merged)
        elif condition is not None:
            raise InputError(f"condition={condition!r}: this environment is of no benchmark and has no conditions")
        if town is not None:
            made["town"] = os.fspath(town)
        if made["town"] is None:
            made["town"] = "town3"
        if traffic is not None:
            made["traffic"] = traffic if isinstance(traffic, str) else ",".join(str(int(n)) for n in traffic)
        if weather is not None:
            made["weathers"] = [weather] if isinstance(weather, str) else list(weather)
        if tick_limit is not None:
            made["tick_limit"] = tick_limit
        if mode == "training":
            merged["world"] = "running"
            merged["criteria"] = {"blocked_after": 4.0}
        elif mode != "evaluation":
            raise InputError(f"mode={mode!r}: expected evaluation or training")
        #: Called for the reward; None: the simulator's own.
        self.reward: RewardFunction | None = None
        if callable(reward):
            self.reward = reward
        elif isinstance(reward, Mapping):
            merged["reward"] = dict(reward)
        elif reward != "wad":
            raise InputError(f"reward={reward!r}: expected 'wad', its constants by name, or a function of "
                             "(observation, action, info)")
        for name, value in dict(options or {}).items():
            both = isinstance(value, Mapping) and isinstance(merged.get(name), dict)
            merged[name] = {**merged[name], **value} if both else value
        made["observation"] = list(parts)
        made["options"] = merged
        made["render"] = render_mode == "rgb_array"
        made["gui"] = render_mode == "human"
        made["record"] = None if record is None else os.fspath(record)
        self.render_mode = render_mode
        camera = merged.get("camera", {})
        self.camera = (camera.get("height", 512), camera.get("width", 512))
        self.action_space, self.controls = actions.of(action)
        try:
            self.text = json.dumps(made)
        except TypeError as error:
            raise InputError(f"an argument is of the wrong type: {error}") from None


def _of_suite(name: str, task: str | None, condition: str | None, made: dict[str, Any], merged: dict[str, Any]) -> None:
    suite = registry.suites().get(name)
    if suite is None:
        raise InputError(f"suite={name!r}: expected one of {', '.join(registry.suites())}")
    tasks = {each["name"]: each for each in suite["tasks"]}
    if task not in tasks:
        raise InputError(f"task={task!r}: expected one of {', '.join(tasks)}")
    found = tasks[task]
    made["task"] = found["kind"]
    made["tick_limit"] = found.get("tick_limit")
    made["traffic"] = found.get("traffic")
    made["endless"] = found.get("endless", False)
    merged["termination"] = suite["termination"]
    # The paper's tasks are trained at places drawn anew; a benchmark is its conditions.
    if condition is None and name in ("tasks", "composite"):
        return
    conditions = {each["name"]: each for each in suite["conditions"]}
    chosen = conditions.get(condition or next(iter(conditions)))
    if chosen is None:
        raise InputError(f"condition={condition!r}: expected one of {', '.join(conditions)}")
    made["town"], made["weathers"], made["routes"] = chosen["town"], chosen["weathers"], found.get("routes")
