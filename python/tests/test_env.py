"""One environment on a real SUMO."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import wad_cosim
from conftest import sumos, until
from wad_cosim import observations

GO = np.float32([0, 0.4, 0])


@pytest.mark.parametrize("id", wad_cosim.ids())
def test_every_id_passes_gymnasiums_check(id):
    env = gymnasium.make(id)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.parametrize(
    ("action", "observation"),
    [
        ("continuous", "image"),
        ("pedal", "dict"),
        ("discrete", "vector"),
        ("continuous", "latent"),
        ("pedal", "transformed"),
        ([[0, 0.5, 0], [0, 0, 1]], ["image", "latent"]),
    ],
)
def test_every_form_passes_gymnasiums_check(make, action, observation):
    check_env(make(action=action, observation=observation, traffic=(5, 5)).unwrapped)


def test_every_number_of_an_observation_has_a_name(make):
    for observation, names in (("raw", observations.RAW_NAMES), ("vector", observations.VECTOR_NAMES)):
        assert make(observation=observation).observation_space.shape == (len(names),) == (len(set(names)),)
    # Names and numbers belong together: the ego drives ahead on a road with a speed limit of 13.89 m/s or less.
    env = make(observation="vector", traffic="empty")
    env.reset(seed=1)
    for _ in range(10):
        numbers, _, _, _, info = env.step(GO)
    found = dict(zip(observations.VECTOR_NAMES, numbers))
    assert found["speed"] == pytest.approx(info["speed"] / 15, rel=1e-5)
    assert 0.05 < found["route_5_ahead"] < found["route_50_ahead"] <= 1.01
    assert 0.2 < found["speed_limit"] <= 2 and found["user_0_there"] == found["user_11_brake_lights"] == 0


def drive(env, seed):
    """The observations, rewards and infos of the expert's episode."""
    observation, info = env.reset(seed=seed)
    found = [(observation, 0.0, info)]
    over = False
    while not over:
        observation, reward, terminated, truncated, info = env.step(env.unwrapped.expert_action())
        found.append((observation, reward, info))
        over = terminated or truncated
        assert not (terminated and truncated)
    return found


def test_the_expert_arrives_and_equal_seeds_are_equal(make):
    env = make()
    first = drive(env, 7)
    observation, reward, info = first[-1]
    assert (info["end"], info["success"], info["events"]) == ("arrival", True, [{"event": "arrival"}])
    assert info["route_done"] > 0.97 and info["tick"] == len(first) - 1
    assert sum(info["reward_terms"].values()) == pytest.approx(reward)
    assert all("events" not in info and "end" not in info for _, _, info in first[:-1])
    second = drive(make(), 7)
    assert len(first) == len(second)
    for (o, r, i), (p, s, j) in zip(first, second):
        assert (o == p).all() and r == s and i == j
    other = drive(env, 8)
    assert len(other) != len(first) or not (other[1][0] == first[1][0]).all()


def test_lights_are_held_at_green_in_every_episode(make):
    # They were in an environment's first episode only.
    env = make(condition="training", weather="ClearNoon")
    for _ in range(2):
        observation, _ = env.reset(seed=1008, options={"route": 8})
        over = False
        while not over:
            assert observation[13] == 0, "a red light"
            observation, _, terminated, truncated, info = env.step(env.unwrapped.expert_action())
            over = terminated or truncated
        assert info["end"] == "arrival"


def test_leaving_the_lane_terminates(make):
    env = make()
    env.reset(seed=1)
    over = False
    while not over:
        _, reward, terminated, truncated, info = env.step(np.float32([0.3, 0.6, 0]))
        over = terminated or truncated
    assert terminated and not truncated
    assert info["end"] in ("outside_lane", "sidewalk") and not info["success"]
    assert info["cause"] and reward < -5
    with pytest.raises(wad_cosim.Error, match="call reset"):
        env.step(GO)


def test_benchmarks_have_their_town_weathers_and_routes(make):
    env = make("NoCrashDense", condition="development")
    _, info = env.reset(seed=3, options={"route": 2})
    env.step(GO)
    first = env.step(GO)[4]
    assert (first["vehicles"], first["pedestrians"]) == (70, 150)
    again = make("NoCrashEmpty", condition="development")
    again.reset(seed=4, options={"route": 2})
    with pytest.raises(wad_cosim.InputError, match="route 99"):
        again.reset(options={"route": 99})
    with pytest.raises(wad_cosim.InputError, match="expected one of training, development, test"):
        make("NoCrashDense", condition="new york")


def test_scenarios_and_configurations_drive(make, tmp_path):
    for town in wad_cosim.scenarios()[:3]:
        env = make("Scenario", town=town)
        env.reset(seed=1)
        env.step(GO)
    net = subprocess.run(
        [sys.executable, "-c", "import sumo, subprocess, sys; sys.exit(subprocess.call([sumo.SUMO_HOME + '/bin/netgenerate', "
         "'--grid', '--grid.number=4', '--grid.length=200', '-o', 'grid.net.xml'], stdout=subprocess.DEVNULL))"],
        cwd=tmp_path,
    )
    assert net.returncode == 0
    env = make("Composite", town=tmp_path / "grid.net.xml", traffic=(10, 0))
    env.reset(seed=1)
    assert env.step(GO)[4]["vehicles"] > 0


def test_a_scenarios_time_limit_holds_at_every_tick_length(make):
    env = make("Scenario", town="accident_ahead", observation="vector", options={"tick_ms": 1000})
    env.reset(seed=1)
    ticks, over = 0, False
    while not over:
        _, _, terminated, truncated, info = env.step(np.float32([0, 0, 1]))
        ticks, over = ticks + 1, terminated or truncated
    assert (ticks, info["end"]) == (68, "timeout")


def test_a_reward_of_ones_own(make):
    def progress(observation, action, info):
        assert observation.shape == (15,) and action.shape == (3,)
        return info["speed"] + 100 * ("end" in info)

    env = make(reward=progress)
    env.reset(seed=2)
    for _ in range(5):
        _, reward, _, _, info = env.step(GO)
        assert reward == info["speed"]
    dear, cheap = make(reward={"steps": 3.0}), make()
    rewards = []
    for env in (dear, cheap):
        env.reset(seed=2)
        rewards.append(env.step(GO)[4]["reward_terms"])
    assert rewards[0]["steps"] != rewards[1]["steps"] and rewards[0]["lane"] == rewards[1]["lane"]


def test_pictures_are_the_observations(make):
    env = make("Composite", observation="dict", render_mode="rgb_array")
    seen, _ = env.reset(seed=5)
    assert (env.render() == seen["image"]).all() and seen["image"].std() > 10
    kept = seen["image"].copy()
    for _ in range(5):
        after = env.step(GO)[0]
    assert (seen["image"] == kept).all(), "an observation stays what it was"
    assert (after["image"] != kept).any()
    blind = make("Composite", render_mode="rgb_array")
    blind.reset(seed=5)
    for _ in range(5):
        blind.step(GO)
    assert (blind.render() == after["image"]).all()


@pytest.mark.parametrize(
    "action",
    [np.float32([0, np.nan, 0]), np.float32([0, 0.4]), np.zeros((2, 3)), "left", None, [0, np.inf, 0], [[0.1], [0.2, 0.3], 0]],
)
def test_wrong_actions_are_refused(make, action):
    env = make().unwrapped
    env.reset(seed=1)
    with pytest.raises(wad_cosim.InputError):
        env.step(action)
    # And nothing is broken by it.
    assert env.step(GO)[4]["tick"] == 1


@pytest.mark.parametrize("action", [-1, 15, 1.5, "3", None, [1, 2]])
def test_wrong_discrete_actions_are_refused(make, action):
    env = make(action="discrete").unwrapped
    env.reset(seed=1)
    with pytest.raises(wad_cosim.InputError, match="from 0 to 14"):
        env.step(action)


@pytest.mark.parametrize(
    ("kwargs", "text"),
    [
        ({"town": "town33"}, "did you mean town3"),
        ({"town": "/nowhere/a.sumocfg"}, "nowhere"),
        ({"traffic": "heavy"}, "as-is, empty, regular, dense"),
        ({"weather": "Snow"}, "ClearNoon"),
        ({"observation": "lidar"}, "expected one of raw"),
        ({"action": "fly"}, "expected one of continuous"),
        ({"detector": "yolo"}, "Known: truth"),
        ({"reward": "more"}, "wad"),
        ({"reward": {"sped": 1}}, "unknown field"),
        ({"mode": "test"}, "evaluation or training"),
        ({"options": {"tick": 3}}, "tick_ms"),
        ({"tick_limit": "long"}, "expected u64"),
    ],
)
def test_wrong_arguments_say_what_is_expected(make, kwargs, text):
    with pytest.raises(wad_cosim.InputError, match=text):
        make(**kwargs)


def test_out_of_order(make):
    env = make().unwrapped
    for call in (lambda: env.step(GO), env.expert_action):
        with pytest.raises(wad_cosim.Error, match="call reset"):
            call()
    env.reset(seed=1)
    env.close()
    env.close()
    for call in (lambda: env.step(GO), env.reset, env.expert_action):
        with pytest.raises(wad_cosim.Error, match="closed"):
            call()
    assert until(lambda: not sumos())


def test_learned_eyes_see_without_libtorch(make):
    env = make("Composite", observation="transformed", detector="eyes", tick_limit=30)
    observation, _ = env.reset(seed=1)
    first = observation.copy()
    for _ in range(20):
        observation, *_ = env.step(GO)
    assert observation.std() > 0 and not np.array_equal(first, observation)


@pytest.mark.parametrize(
    ("kwargs", "text"),
    [
        ({"observation": "transformed", "detector": "eyes:missing"}, "eyes:missing"),
        ({"observation": "latent", "options": {"camera": {"fov_deg": 60}}}, "encoder: .*fov 90.*fov 60"),
    ],
)
def test_eyes_that_cannot_be_are_refused(make, kwargs, text):
    with pytest.raises(wad_cosim.InputError, match=text):
        make("Composite", **kwargs).reset(seed=1)


def test_the_sumo_is_the_packages_own(make):
    env = make()
    env.reset(seed=1)
    assert "site-packages/sumo/" in os.readlink(f"/proc/{env.unwrapped.sumo_pid}/exe")


@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_a_sumo_that_is_killed_or_hangs_costs_one_truncated_episode(make, fault):
    env = make(options={"tick_timeout": 1})
    env.reset(seed=1)
    env.step(GO)
    sumo = env.unwrapped.sumo_pid
    os.kill(sumo, fault)
    _, reward, terminated, truncated, info = env.step(GO)
    assert (reward, terminated, truncated, info["end"]) == (0.0, False, True, "error")
    assert ("SUMO hangs" if fault == signal.SIGSTOP else "SUMO") in info["cause"]
    env.reset(seed=1)
    assert env.step(GO)[4]["tick"] == 1
    assert not os.path.exists(f"/proc/{sumo}")


@pytest.mark.parametrize("made", ["wad_cosim.DrivingEnv(task='straight')", "wad_cosim.DrivingVectorEnv(4, task='straight')"])
def test_a_killed_python_leaves_no_sumo(tmp_path, made):
    script = (
        f"import wad_cosim, time; env = {made}; env.reset(seed=1)\n"
        "print(getattr(env, 'sumo_pids', None) or [env.sumo_pid], flush=True); time.sleep(600)"
    )
    child = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    pids = json.loads(child.stdout.readline())
    assert pids and all(os.path.exists(f"/proc/{pid}") for pid in pids)
    child.kill()
    child.wait()
    assert until(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in pids))


def test_a_dropped_environment_leaves_no_sumo():
    env = wad_cosim.DrivingEnv(task="straight")
    env.reset(seed=1)
    pid = env.sumo_pid
    del env
    assert until(lambda: pid not in sumos())


def test_a_signal_ends_a_long_reset(make):
    env = make("Composite", traffic=(150, 200)).unwrapped
    # A reset that waits for SUMO until the signal came.
    holder = threading.Thread(target=interrupt_when_sumo_starts)
    holder.start()
    with pytest.raises(KeyboardInterrupt):
        while True:
            env.reset()
    holder.join()
    env.reset(seed=1)
    assert env.step(GO)[4]["tick"] == 1


def test_a_signal_ends_a_step_while_sumo_hangs(make):
    env = make(options={"tick_timeout": 600})
    env.reset(seed=1)
    os.kill(env.unwrapped.sumo_pid, signal.SIGSTOP)
    sender = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    sender.start()
    with pytest.raises(KeyboardInterrupt):
        env.step(GO)
    sender.join()
    with pytest.raises(wad_cosim.Error, match="call reset first"):
        env.unwrapped.step(GO)
    env.reset(seed=1)
    assert env.step(GO)[4]["tick"] == 1


def interrupt_when_sumo_starts():
    if until(lambda: bool(sumos())):
        time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)


def test_other_threads_run_while_it_steps(make):
    env = make("Composite", observation="image")
    env.reset(seed=1)
    counts, stop = [0], threading.Event()

    def count():
        while not stop.is_set():
            counts[0] += 1
            time.sleep(0)

    counter = threading.Thread(target=count)
    counter.start()
    for _ in range(30):
        env.step(GO)
    stop.set()
    counter.join()
    assert counts[0] > 30


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_fork_is_refused_or_safe(make):
    env = make()
    env.reset(seed=1)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        text = ""
        try:
            env.step(GO)
        except wad_cosim.Error as error:
            text = str(error)
        # One's own works.
        own = gymnasium.make("wad_cosim/Straight-v0")
        own.reset(seed=1)
        text += f" tick {own.step(GO)[4]['tick']}"
        own.close()
        del env
        os.write(writer, text.encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    assert "another process" in text and text.endswith("tick 1")
    assert env.step(GO)[4]["tick"] == 1
