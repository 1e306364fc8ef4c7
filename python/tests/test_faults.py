"""Many environments, many resets: no port lost, no SUMO left, no memory kept."""

import os

import numpy as np

import wad_cosim
from conftest import sumos, until


#: Of the test of memory; docs/python.md has the figures of 10,000.
RESETS = int(os.environ.get("WAD_COSIM_TEST_RESETS", 1500))


def memory():
    """This process's memory (bytes)."""
    with open("/proc/self/statm") as statm:
        return 4096 * int(statm.read().split()[1])


def test_64_environments_in_one_process():
    env = wad_cosim.DrivingVectorEnv(64, task="straight")
    env.reset(seed=1)
    assert len(sumos()) == 64
    go = np.tile(np.float32([0, 0.4, 0]), (64, 1))
    for _ in range(5):
        info = env.step(go)[4]
    assert (info["tick"] == 5).all() and (info["speed"] > 0.1).all()
    env.close()
    assert until(lambda: not sumos())


def test_resets_keep_no_memory():
    env = wad_cosim.DrivingEnv(task="straight", mode="training")
    go = np.float32([0, 0.4, 0])
    for count in range(RESETS):
        env.reset(seed=count)
        env.step(go)
        if count == 500:
            before = memory()
    after = memory()
    env.close()
    print(f"{before} bytes after 500 resets, {after} after {RESETS}")
    assert after < 1.05 * before, f"{before} bytes after 500 resets, {after} after {RESETS}"
    assert until(lambda: not sumos())


def test_fresh_worlds_leave_nothing():
    env = wad_cosim.DrivingEnv(task="straight")
    for count in range(20):
        env.reset(seed=count)
        assert len(sumos()) == 1
    env.close()
    assert until(lambda: not sumos())
