"""Many environments at once give the arrays of Gymnasium's own wrapper."""

import os
import signal

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space

import wad_cosim
from conftest import sumos, until

N = 3


def same(first, second, path=""):
    """Fails where two observations or infos differ, in values or in types."""
    assert type(first) is type(second), path
    if isinstance(first, dict):
        assert first.keys() == second.keys(), path
        for key in first:
            same(first[key], second[key], f"{path}/{key}")
    elif isinstance(first, (tuple, list)):
        assert len(first) == len(second), path
        for i, (a, b) in enumerate(zip(first, second)):
            same(a, b, f"{path}[{i}]")
    elif isinstance(first, np.ndarray):
        assert (first.dtype, first.shape) == (second.dtype, second.shape), path
        if first.dtype == object:
            for i, (a, b) in enumerate(zip(first, second)):
                same(a, b, f"{path}[{i}]")
        else:
            assert (first == second).all(), path
    else:
        assert first == second, path


def both(mode, **kwargs):
    """The native environments and Gymnasium's, of a task whose episodes are short."""
    kwargs = {"tick_limit": 12, **kwargs}
    native = gymnasium.make_vec("wad_cosim/Straight-v0", num_envs=N, autoreset_mode=mode, **kwargs)
    assert isinstance(native, wad_cosim.DrivingVectorEnv)
    one = lambda: gymnasium.make("wad_cosim/Straight-v0", disable_env_checker=True, **kwargs)  # noqa: E731
    return native, SyncVectorEnv([one] * N, autoreset_mode=mode)


@pytest.mark.parametrize(
    ("mode", "observation"), [*((mode, "raw") for mode in AutoresetMode), (AutoresetMode.SAME_STEP, "dict")]
)
def test_equal_seeds_give_gymnasiums_arrays(mode, observation):
    native, sync = both(mode, observation=observation, traffic=(4, 4))
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.metadata["autoreset_mode"] == sync.metadata["autoreset_mode"] == mode
    same(native.reset(seed=11), sync.reset(seed=11))
    rng = np.random.default_rng(3)
    ended = 0
    # One leaves its lane before the tick limit: episodes end at different steps.
    steer = np.float32([0.5, 0.0, -0.2])
    for tick in range(30):
        actions = np.stack([steer, rng.uniform(0, 1, N), np.zeros(N)], axis=1).astype(np.float32)
        found, expected = native.step(actions), sync.step(actions)
        same(found, expected, f"tick {tick}")
        over = found[2] | found[3]
        ended += int(over.sum())
        if mode == AutoresetMode.DISABLED and over.any():
            seeds = [None, 5, None] if tick < 15 else None
            same(
                native.reset(seed=seeds, options={"reset_mask": over}),
                sync.reset(seed=seeds, options={"reset_mask": over}),
            )
    assert ended >= 2 * N
    same(native.reset(), sync.reset())
    same(native.reset(seed=[7, None, 9]), sync.reset(seed=[7, None, 9]))
    native.close(), sync.close()


def test_a_reward_of_ones_own_is_gymnasiums():
    def reward(observation, action, info):
        return info["speed"] + float(observation[0]) - float(action[1]) - 100 * ("end" in info)

    for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
        native, sync = both(mode, reward=reward)
        native.reset(seed=1), sync.reset(seed=1)
        for _ in range(30):
            actions = np.tile(np.float32([0.1, 0.5, 0]), (N, 1))
            same(native.step(actions)[1], sync.step(actions)[1])
        native.close(), sync.close()


def test_discrete_actions_and_pictures():
    env = gymnasium.make_vec(
        "wad_cosim/Composite-v0", num_envs=2, action="discrete", render_mode="rgb_array", traffic=(5, 0)
    )
    assert env.action_space == batch_space(env.single_action_space, 2)
    env.reset(seed=1)
    env.step(env.action_space.sample())
    pictures = env.render()
    assert len(pictures) == 2 and pictures[0].shape == (512, 512, 3)
    assert (pictures[0] != pictures[1]).any()
    assert env.unwrapped.expert_actions().shape == (2, 3)
    env.close()


def test_the_expert_drives_on_after_an_episodes_end():
    env = wad_cosim.DrivingVectorEnv(2, task="straight", tick_limit=2)
    env.reset(seed=1)
    ticks = []
    for _ in range(5):
        actions = env.expert_actions()
        ticks.append(env.step(actions)[4]["tick"].tolist())
        assert (actions == 0).all() == (ticks[-1] == [0, 0])
    assert ticks == [[1, 1], [2, 2], [0, 0], [1, 1], [2, 2]]
    env.close()


def test_without_copies_the_arrays_stay_the_same():
    env = wad_cosim.DrivingVectorEnv(2, task="straight", copy=False)
    first, _ = env.reset(seed=1)
    second = env.step(np.tile(np.float32([0, 1, 0]), (2, 1)))[0]
    assert first is second
    env.close()


def test_wrong_use_is_refused():
    env = wad_cosim.DrivingVectorEnv(2, task="straight", autoreset_mode=AutoresetMode.DISABLED)
    go = np.tile(np.float32([0, 0.4, 0]), (2, 1))
    with pytest.raises(wad_cosim.Error, match="call reset"):
        env.step(go)
    env.reset(seed=1)
    for actions in (go[0], np.full((2, 3), np.nan), np.zeros((3, 3)), None):
        with pytest.raises(wad_cosim.InputError):
            env.step(actions)
    for mask in (np.zeros(2, bool), np.ones(3, bool), [True, False], np.ones(2)):
        with pytest.raises(wad_cosim.InputError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})
    with pytest.raises(wad_cosim.InputError, match="expected 2 seeds"):
        env.reset(seed=[1, 2, 3])
    env.step(go)
    env.close()
    with pytest.raises(wad_cosim.Error, match="closed"):
        env.step(go)
    with pytest.raises(wad_cosim.InputError, match="num_envs"):
        wad_cosim.DrivingVectorEnv(0, task="straight")


@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_a_sumo_that_is_killed_or_hangs_costs_its_own_episode(fault):
    env = wad_cosim.DrivingVectorEnv(3, task="straight", options={"tick_timeout": 1})
    env.reset(seed=1)
    go = np.tile(np.float32([0, 0.4, 0]), (3, 1))
    env.step(go)
    os.kill(env.sumo_pids[1], fault)
    _, _, terminated, truncated, info = env.step(go)
    assert truncated.tolist() == [False, True, False] and not terminated.any()
    assert info["end"][1] == "error" and info["_end"].tolist() == [False, True, False]
    info = env.step(go)[4]
    assert info["tick"].tolist() == [3, 0, 3]
    assert env.step(go)[4]["tick"].tolist() == [4, 1, 4]
    env.close()
    assert until(lambda: not sumos())


def test_gymnasiums_processes_work_too():
    env = gymnasium.make_vec("wad_cosim/Straight-v0", num_envs=2, vectorization_mode="async")
    env.reset(seed=1)
    env.step(np.tile(np.float32([0, 0.4, 0]), (2, 1)))
    env.close()


def fleet(seed, ticks=60):
    """The steps of egos that share their SUMOs."""
    env = gymnasium.make_vec(
        "wad_cosim/Composite-v0", num_envs=12, egos=6, observation="vector", traffic=(10, 10), mode="training"
    )
    found = [env.reset(seed=seed)]
    actions = np.tile(np.float32([0, 0.5, 0]), (12, 1))
    actions[::2, 0] = 0.4
    for _ in range(ticks):
        found.append(env.step(actions))
        assert env.observation_space.contains(found[-1][0])
    assert len(set(env.unwrapped.sumo_pids)) == 2
    env.close()
    return found


def test_egos_share_a_sumo():
    first = fleet(4)
    assert first[0][0].shape == (12, 187)
    ended = [step[2] | step[3] for step in first[1:]]
    assert sum(int(over.sum()) for over in ended) >= 6
    for before, after in zip(first[1:], first[2:]):
        over = before[2] | before[3]
        # The step after an end begins the next episode; an ego without a free place waits.
        assert (after[1][over] == 0).all() and not (after[2] | after[3])[over].any()
        assert (after[4]["tick"][~over] >= before[4]["tick"][~over]).all()
    same(first, fleet(4))


def test_egos_that_left_are_paid_nothing():
    env = wad_cosim.DrivingVectorEnv(
        2,
        AutoresetMode.DISABLED,
        egos=2,
        task="straight",
        traffic="empty",
        tick_limit=2,
        reward=lambda *_: 1.0,
    )
    env.reset(seed=1)
    go = np.tile(np.float32([0, 0.5, 0]), (2, 1))
    assert env.step(go)[1].tolist() == [1, 1]
    # What egos in one SUMO do not have is refused, and they drive on.
    with pytest.raises(wad_cosim.InputError, match="route 3"):
        env.reset(options={"route": 3})
    with pytest.raises(wad_cosim.InputError, match="none of this"):
        env.expert_actions()
    assert [env.step(go)[1].tolist() for _ in range(3)] == [[1, 1], [0, 0], [0, 0]]
    env.close()


def test_each_episode_of_egos_in_one_sumo_draws_its_weather():
    def drive(weather):
        env = wad_cosim.DrivingVectorEnv(
            2,
            egos=2,
            task="straight",
            observation="transformed",
            traffic="empty",
            weather=weather,
            mode="training",
            tick_limit=1,
        )
        found = [env.reset(seed=2)[0]]
        for _ in range(12):
            found.append(env.step(np.zeros((2, 3), np.float32))[0])
        env.close()
        return np.stack(found)

    clear, drawn = drive("ClearNoon"), drive(["ClearNoon", "HardRainSunset"])
    is_clear = (drawn == clear).all(axis=(2, 3, 4))
    assert is_clear.any(axis=0).all() and not is_clear.all(axis=0).any()


@pytest.mark.parametrize(
    ("kwargs", "text"),
    [
        ({"num_envs": 5, "egos": 2}, "multiple of egos=2"),
        ({"num_envs": 4, "egos": 2, "autoreset_mode": AutoresetMode.SAME_STEP}, "NEXT_STEP or DISABLED"),
        ({"num_envs": 4, "egos": 2, "observation": "image"}, "pictures"),
        ({"num_envs": 4, "egos": 0}, "1 or more"),
    ],
)
def test_egos_that_cannot_be(kwargs, text):
    with pytest.raises(wad_cosim.InputError, match=text):
        wad_cosim.DrivingVectorEnv(task="composite", **kwargs)
