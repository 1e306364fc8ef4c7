"""Several egos in one SUMO as PettingZoo's agents."""

import os
import signal

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import wad_cosim
from conftest import sumos, until
from wad_cosim.pettingzoo import DrivingParallelEnv


def make(egos=3, **kwargs):
    kwargs = {"observation": "vector", "mode": "training", "traffic": (6, 6), "tick_limit": 40, **kwargs}
    return DrivingParallelEnv("wad_cosim/Straight-v0", egos, **kwargs)


def test_its_own_test_of_the_interface():
    env = make()
    parallel_api_test(env, num_cycles=120)
    env.close()
    assert until(lambda: not sumos())


def test_its_own_test_of_seeds():
    # Fresh worlds: an episode depends on its seed alone.
    parallel_seed_test(lambda: make(2, mode="evaluation"), num_cycles=10)


def test_egos_leave_when_they_end():
    env = make(4, tick_limit=None)
    env.reset(seed=1)
    assert env.agents == ["ego_0", "ego_1", "ego_2", "ego_3"] and len(sumos()) == 1
    # The first two turn off the road, the others stand.
    off, stand = np.float32([0.5, 0.8, 0]), np.float32([0, 0, 1])
    ended = {}
    for tick in range(1, 100):
        before = set(env.agents)
        actions = {agent: off if agent in ("ego_0", "ego_1") else stand for agent in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(actions)
        for each in (observations, rewards, terminations, truncations, infos):
            assert each.keys() == before
        assert all(info["tick"] == tick for info in infos.values())
        gone = {agent for agent in before if terminations[agent] or truncations[agent]}
        ended.update({agent: infos[agent]["end"] for agent in gone})
        assert set(env.agents) == before - gone
        if not env.agents:
            break
    assert {"ego_0", "ego_1"} <= ended.keys()
    # Standing without a reason ends an episode in training.
    assert not env.agents and env.step({}) == ({}, {}, {}, {}, {})
    again, _ = env.reset(seed=2)
    assert again.keys() == set(env.possible_agents) == set(env.agents)
    # They are back on the road: all drive.
    for _ in range(10):
        infos = env.step({agent: np.float32([0, 0.5, 0]) for agent in env.agents})[4]
    assert all(info["speed"] > 0.5 for info in infos.values())
    env.close()


def test_an_ego_that_left_is_in_nobodys_way():
    # The surroundings of those who drive on hold nobody who has left: town without traffic, two egos.
    env = make(2, traffic="empty", tick_limit=None)
    users = slice(28, 172)
    env.reset(seed=3)
    while "ego_1" in env.agents:
        go, off = np.float32([0, 0.2, 0]), np.float32([0.5, 0.9, 0])
        env.step({agent: off if agent == "ego_1" else go for agent in env.agents})
    assert env.agents == ["ego_0"]
    for _ in range(3):
        observations = env.step({"ego_0": np.float32([0, 0.2, 0])})[0]
    assert (observations["ego_0"][users] == 0).all()
    env.close()


def test_a_reward_and_actions_of_ones_own():
    env = make(2, action="discrete", reward=lambda observation, action, info: info["speed"] + action)
    env.reset(seed=1)
    _, rewards, _, _, infos = env.step({"ego_0": 8, "ego_1": 7})
    assert rewards["ego_0"] == infos["ego_0"]["speed"] + 8
    with pytest.raises(wad_cosim.InputError, match="ego_1 missing"):
        env.step({"ego_0": 8})
    env.close()
    with pytest.raises(wad_cosim.Error, match="closed"):
        env.reset()


def test_a_killed_sumo_ends_the_episodes():
    env = make(2)
    env.reset(seed=1)
    go = {agent: np.float32([0, 0.4, 0]) for agent in env.agents}
    env.step(go)
    os.kill(env.sumo_pid, signal.SIGKILL)
    _, _, terminations, truncations, infos = env.step(go)
    assert all(truncations.values()) and not any(terminations.values()) and not env.agents
    assert all(info["end"] == "error" for info in infos.values())
    env.reset(seed=1)
    assert all(info["tick"] == 1 for info in env.step(go)[4].values())
    env.close()
