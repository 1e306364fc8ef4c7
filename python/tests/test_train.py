"""Training on Ray: it goes on, whatever dies on the way."""

import json
import os
import signal

import numpy as np
import pytest
from conftest import until
from ray_cluster import children, cluster, finish, nodes, processes, raylet, start  # noqa: F401

import wad_cosim

pytest.importorskip("torch")
from wad_cosim.learn.training import steps_of  # noqa: E402

STEPS = 2_500
#: Small, so that deaths meet every part of it within seconds.
OPTIONS = {
    "--egos": 4,
    "--segment": 16,
    "--learning-starts": 300,
    "--update-ratio": 0.25,
    "--batch": 32,
    "--checkpoint-every": 400,
    "--seed": 3,
}
COMMAND = ["train", *(str(part) for pair in OPTIONS.items() for part in pair)]
MORE = ["train"]


def log(out):
    """The lines of the training's log that are whole."""
    file = out / "train.jsonl"
    lines = file.read_text().splitlines(keepends=True) if file.exists() else []
    return [json.loads(line) for line in lines if line.endswith("\n")]


def step(out):
    return max((line["global_step"] for line in log(out)), default=0)


def saved(out):
    """Steps of the last checkpoint."""
    file = out / "checkpoint.pt"
    return steps_of(file.read_bytes()) if file.exists() else 0


def wait_for(driver, what):
    assert until(lambda: what() or driver.poll() is not None, 120)
    assert driver.poll() is None, finish(driver)


def assert_trained(out, said, steps=STEPS):
    """It came to its end with an agent that drives, and nothing is left running."""
    assert f"{out}: " in said
    assert saved(out) >= steps
    steps = [line["global_step"] for line in log(out)]
    assert steps == sorted(steps) and steps[-1] <= saved(out), "the log is of what was learned"
    episodes = [line for line in log(out) if "end" in line]
    assert {line["by"] for line in episodes} == {"agent", "start"}
    losses = [line["losses/qf1_loss"] for line in log(out) if "losses/qf1_loss" in line]
    assert losses and np.isfinite(losses).all()
    action = wad_cosim.load_agent(out / "last.safetensors").act(np.zeros(15, np.float32))
    assert np.isfinite(action).all()
    assert until(lambda: not processes("sumo")), "a SUMO is left"


def test_a_collector_and_the_learner_die(nodes, start, tmp_path):
    out = tmp_path / "out"
    driver = start(COMMAND, out, "--steps", str(STEPS))
    wait_for(driver, lambda: step(out) >= 300)
    for collector in processes("ray::Collector"):
        os.kill(collector, signal.SIGKILL)
    before = step(out)
    wait_for(driver, lambda: step(out) > before and saved(out))
    (learner,) = processes("ray::Learner")
    os.kill(learner, signal.SIGKILL)
    said = finish(driver)
    assert "on from the last checkpoint" in said and " 2 restarts" in said
    assert_trained(out, said)


def test_the_learners_node_and_the_driver_die(cluster, nodes, start, tmp_path):
    cluster.add_node(num_cpus=1, node_ip_address="127.0.0.1")
    out = tmp_path / "out"
    first = start([*COMMAND, "--algo", "sac"], out, "--steps", str(STEPS))
    wait_for(first, lambda: saved(out))
    assert "another process" in finish(start(MORE, out, "--steps", "1", "--resume"), 2)
    (victim,) = (node for node in cluster.worker_nodes if children(raylet(node), "ray::Learner"))
    cluster.remove_node(victim, allow_graceful=False)
    before = saved(out)
    wait_for(first, lambda: saved(out) > before)
    first.kill()
    first.wait()
    assert until(lambda: not processes("sumo")), "a SUMO outlives the driver"
    done = saved(out)
    assert "--resume goes on" in finish(start(COMMAND, out, "--steps", str(STEPS)), 2)
    assert "leave out seed" in finish(start([*MORE, "--seed", "4"], out, "--steps", str(STEPS), "--resume"), 2)
    second = start(MORE, out, "--steps", str(10 * STEPS), "--resume")
    wait_for(second, lambda: step(out) > done)
    assert min(line["global_step"] for line in log(out)) < done, "the log of before is kept"
    second.send_signal(signal.SIGINT)
    assert "--resume goes on" in finish(second, 4)
    assert saved(out) > done
    last = saved(out) + 200
    assert_trained(out, finish(start(MORE, out, "--steps", str(last), "--resume")), last)
