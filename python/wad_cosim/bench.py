"""``python -m wad_cosim.bench``: steps a second of ``env.step`` beside the same steps without Python, and of many egos."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np

from . import _native
from .env import DrivingEnv
from .setup import Setup
from .vector import DrivingVectorEnv


def _one(observation: str, seed: int, steps: int) -> tuple[float, float]:
    """Seconds a step, without Python and with it: the least of three drives each, one after the other."""
    kwargs: dict[str, Any] = {"task": "composite", "observation": observation}
    setup = Setup(**kwargs)
    without, within = [], []
    for _ in range(3):
        seconds, driven = _native.bench(setup.text, seed, steps)
        without.append(seconds / driven)
        env = DrivingEnv(**kwargs)
        env.reset(seed=seed)
        seconds, driven, over = 0.0, 0, False
        while driven < steps and not over:
            action = env.expert_action()
            begin = time.perf_counter()
            _, _, terminated, truncated, _ = env.step(action)
            seconds += time.perf_counter() - begin
            driven += 1
            over = terminated or truncated
        within.append(seconds / driven)
        env.close()
    return min(without), min(within)


def _many(egos: int, sumos: int, steps: int) -> float:
    """Agent-steps a second."""
    env = DrivingVectorEnv(
        egos * sumos, egos=egos, task="composite", observation="vector", mode="training", traffic="empty", copy=False
    )
    env.reset(seed=1)
    actions = np.tile(np.array([0, 0.4, 0], np.float32), (egos * sumos, 1))
    for _ in range(20):
        env.step(actions)
    begin = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    seconds = time.perf_counter() - begin
    env.close()
    return steps * egos * sumos / seconds


def main(arguments: list[str] | None = None) -> int:
    """The program; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m wad_cosim.bench", description=__doc__.split(": ", 1)[1])
    parser.add_argument("--steps", type=int, default=300, help="of each measurement (default 300)")
    options = parser.parse_args(arguments)
    print("composite task, 70 vehicles and 100 pedestrians, driven by the expert:")
    print("  observation   without Python      env.step    more")
    for observation in ("raw", "vector", "image"):
        without, within = _one(observation, 7, options.steps)
        more = 100 * (within / without - 1)
        print(f"  {observation:12} {1 / without:10.0f} /s {1 / within:12.0f} /s {more:6.1f} %")
    print("egos that share a SUMO, empty town, observation vector, constant action:")
    for egos, sumos in ((16, 1), (25, 2), (50, 1)):
        print(f"  {egos:3} egos in {sumos} SUMO: {_many(egos, sumos, options.steps):8.0f} agent-steps/s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
