"""Stable-Baselines3, where it is installed."""

import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")


def test_its_environments_are_gymnasiums():
    from wad_cosim import DrivingVectorEnv
    from wad_cosim.sb3 import DrivingVecEnv

    kwargs = {"tick_limit": 10}
    env = DrivingVecEnv("wad_cosim/Straight-v0", 3, **kwargs)
    other = DrivingVectorEnv(3, autoreset_mode="SameStep", task="straight", suite="tasks", **kwargs)
    env.seed(5)
    assert (env.reset() == other.reset(seed=5)[0]).all()
    ended = 0
    for _ in range(25):
        actions = np.tile(np.float32([0.4, 0.7, 0]), (3, 1))
        observations, rewards, over, infos = env.step(actions)
        found = other.step(actions)
        assert (observations == found[0]).all() and (rewards == found[1].astype(np.float32)).all()
        assert (over == found[2] | found[3]).all()
        for i, info in enumerate(infos):
            assert bool(info) == over[i]
            if over[i]:
                ended += 1
                assert (info["terminal_observation"] == found[4]["final_obs"][i]).all()
                assert info["TimeLimit.truncated"] == found[3][i]
    assert ended >= 6
    env.close(), other.close()


def test_the_example_learns_to_arrive(tmp_path):
    example = pathlib.Path(__file__).parents[1] / "examples" / "sb3_sac.py"
    done = subprocess.run([sys.executable, example], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("25000 steps in ")
    successes, episodes = map(int, re.search(r"success in (\d+) of (\d+) episodes", done.stdout).groups())
    assert episodes == 25 and successes >= 20, done.stdout
