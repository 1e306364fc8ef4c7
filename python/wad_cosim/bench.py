"""``python -m wad_cosim.bench``: steps a second of ``env.step`` beside the same steps without Python, of many egos, and of
neighbours that are installed."""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import importlib.util
import os
import pathlib
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from . import _native
from .observations import VECTOR_NAMES
from .setup import Setup
from .vector import DrivingVectorEnv

#: Turns, in each of which both drive the same episode: other work on the machine slows some.
_TURNS = 11
#: Steps of many egos before the measurement.
_WARM_UP = 60


def _one(observation: str, seed: int, steps: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Seconds a step in each turn, without Python and as ``gymnasium.make`` makes the environment."""
    id = "wad_cosim/Composite-v0"
    text = Setup(**gymnasium.spec(id).kwargs, observation=observation).text
    without, within = np.empty(_TURNS), np.empty(_TURNS)
    for turn in range(_TURNS):
        without[turn] = np.mean(_native.bench(text, seed, steps))
        env = gymnasium.make(id, observation=observation)
        expert = env.unwrapped.expert_action  # type: ignore[attr-defined]
        env.reset(seed=seed)
        seconds: list[float] = []
        over = False
        while len(seconds) < steps and not over:
            action = expert()
            begin = time.perf_counter()
            _, _, terminated, truncated, _ = env.step(action)
            seconds.append(time.perf_counter() - begin)
            over = terminated or truncated
        within[turn] = np.mean(seconds)
        env.close()  # type: ignore[no-untyped-call, unused-ignore]
    return without, within


def _follow(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Drives along the route at 8 m/s, slower in bends; stops behind others and at lights. (N, 187) to (N, 3)."""
    number = {name: vectors[:, VECTOR_NAMES.index(name)] for name in _FOLLOWED}
    # Nearness 0.5 is 6 m.
    near = np.maximum(number["lead_nearness"], number["stop_light_nearness"])
    wanted = np.maximum(8 - 8 * np.abs(number["bearing_far"]), 3) * (1 - np.clip((near - 0.25) / 0.3, 0, 1))
    error = 0.3 * (wanted - 15 * number["speed"])
    return np.stack([np.clip(1.3 * number["bearing"], -1, 1), np.clip(error, 0, 1), np.clip(-error, 0, 1)], axis=1)


_FOLLOWED = ("speed", "bearing", "bearing_far", "lead_nearness", "stop_light_nearness")


def _many(egos: int, sumos: int, traffic: str, steps: int) -> float:
    """Agent-steps a second of ``env.step``; episodes that end begin anew in it."""
    env = DrivingVectorEnv(
        egos * sumos, egos=egos, task="composite", observation="vector", mode="training", traffic=traffic, copy=False
    )
    vectors, _ = env.reset(seed=1)
    seconds = 0.0
    for step in range(_WARM_UP + steps):
        actions = _follow(vectors)
        begin = time.perf_counter()
        vectors, *_ = env.step(actions)
        if step >= _WARM_UP:
            seconds += time.perf_counter() - begin
    env.close()
    return steps * egos * sumos / seconds


def _highway() -> tuple[str, gymnasium.Env[Any, Any]]:
    importlib.import_module("highway_env")
    config = {"vehicles_count": 70, "simulation_frequency": 6, "policy_frequency": 6, "duration": 10_000}
    env = gymnasium.make("highway-v0", config=config)
    return "highway-v0, kinematics of 5 vehicles (25 numbers), 70 vehicles, no lights or people, 6 Hz", env


def _metadrive() -> tuple[str, gymnasium.Env[Any, Any]]:
    made = importlib.import_module("metadrive").MetaDriveEnv({"use_render": False, "traffic_density": 0.1, "log_level": 50})
    return "MetaDriveEnv, lidar (259 numbers), traffic density 0.1, no people, 10 Hz", made


def _sumo_rl() -> tuple[str, gymnasium.Env[Any, Any]]:
    # It finds SUMO by the environment, as ours does by its package.
    sumo = importlib.util.find_spec("sumo")
    if sumo is not None and sumo.submodule_search_locations:
        os.environ.setdefault("SUMO_HOME", sumo.submodule_search_locations[0])
    module = importlib.import_module("sumo_rl")
    nets = pathlib.Path(module.__file__ or "").parent / "nets" / "single-intersection"
    env = module.SumoEnvironment(
        str(nets / "single-intersection.net.xml"),
        str(nets / "single-intersection.rou.xml"),
        single_agent=True,
        num_seconds=100_000,
        sumo_warnings=False,
        additional_sumo_cmd="--no-step-log true",
    )
    return "SumoEnvironment, densities and queues of one intersection (a signal's view, no ego), 5 s a step", env


#: By the name of the package: what makes an environment, and says what it observes.
_NEIGHBOURS: dict[str, Callable[[], tuple[str, gymnasium.Env[Any, Any]]]] = {
    "highway-env": _highway,
    "metadrive-simulator": _metadrive,
    "sumo-rl": _sumo_rl,
}


def _neighbour(make: Callable[[], tuple[str, gymnasium.Env[Any, Any]]], steps: int) -> tuple[str, float]:
    """What it observes, and its steps a second with random actions; resets are not counted."""
    observes, env = make()
    env.reset(seed=1)
    env.action_space.seed(1)
    seconds = 0.0
    for _ in range(steps):
        action = env.action_space.sample()
        begin = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        seconds += time.perf_counter() - begin
        if terminated or truncated:
            env.reset()
    env.close()  # type: ignore[no-untyped-call, unused-ignore]
    return observes, steps / seconds


def main(arguments: list[str] | None = None) -> int:
    """The program; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m wad_cosim.bench", description=__doc__.split(": ", 1)[1])
    parser.add_argument("--steps", type=int, default=300, help="of each measurement (default 300)")
    options = parser.parse_args(arguments)
    print("composite task, 70 vehicles and 100 pedestrians, driven by the expert:")
    print(f"  observation   without Python      env.step    more (medians of {_TURNS} turns, quartiles)")
    for observation in ("raw", "vector", "image"):
        without, within = _one(observation, 7, options.steps)
        low, more, high = 100 * (np.quantile(within / without, [0.25, 0.5, 0.75]) - 1)
        rates = 1 / np.median(without), 1 / np.median(within)
        print(f"  {observation:12} {rates[0]:10.0f} /s {rates[1]:12.0f} /s {more:6.1f} % ({low:.1f} to {high:.1f})", flush=True)
    print("egos that share a SUMO, observation vector, which they follow their routes by:")
    for traffic, town in (("empty", "an empty town"), ("70,100", "70 vehicles and 100 pedestrians")):
        for egos, sumos in ((16, 1), (25, 2), (50, 1)):
            rate = _many(egos, sumos, traffic, options.steps)
            print(f"  {egos:3} egos in each of {sumos} SUMO, {town}: {rate:8.0f} agent-steps/s", flush=True)
    print("neighbours in the same run, random actions; compare only what observes and simulates the like:")
    for package, make in _NEIGHBOURS.items():
        try:
            version = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            print(f"  {package}: not installed, left out")
            continue
        try:
            observes, rate = _neighbour(make, options.steps)
        except Exception as error:
            # Their own faults, such as assets that cannot be downloaded, are theirs.
            print(f"  {package} {version}: left out, it does not start: {type(error).__name__}: {error}")
            continue
        print(f"  {package} {version}: {rate:8.0f} /s  {observes}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
