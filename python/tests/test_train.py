"""Training on Ray: it goes on, whatever dies on the way."""

import json
import os
import pathlib
import signal
import subprocess
import time
import types

import numpy as np
import pytest
from conftest import until
from ray_cluster import children, cluster, finish, nodes, processes, raylet, seconds, start  # noqa: F401

import wad_cosim

pytest.importorskip("torch")
from wad_cosim.learn.training import Settings, steps_of  # noqa: E402
from wad_cosim.ray.training import Folder  # noqa: E402

#: `cargo build` makes it.
PROGRAM = pathlib.Path(__file__).parents[2] / "target" / "release" / "wad-cosim"
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
    assert until(lambda: what() or driver.poll() is not None, 300)
    assert driver.poll() is None, finish(driver)


def at_work(driver, out):
    """The collector, once it has driven for a while, and its SUMOs."""
    wait_for(driver, lambda: step(out) >= 300)
    (collector,) = processes("ray::Collector")
    sumos = children(collector, "sumo")
    assert sumos
    return collector, sumos


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


def test_a_turn_that_is_lost_between_its_answer_and_the_learner_costs_that_turn_only(cluster, nodes, start, tmp_path):
    """A turn of more than 100 kB stays on its collector's node until the learner fetches it."""
    import ray
    from ray.util.placement_group import placement_group_table

    out = tmp_path / "out"
    driver = start([*COMMAND, "--segment", "600"], out, "--steps", "50000")
    wait_for(driver, lambda: step(out) > 0)
    (learner,), (collector,) = processes("ray::Learner"), processes("ray::Collector")
    os.kill(learner, signal.SIGSTOP)
    try:
        # It is at most a turn ahead of the learner, and rests then.
        used = [-1.0, 0.0]

        def rests():
            time.sleep(1)
            used[:] = used[1], seconds(collector)
            return used[1] - used[0] < 0.2

        wait_for(driver, rests)
        (victim,) = (node for node in nodes if children(raylet(node), "ray::Collector"))
        ray.init(cluster.address, log_to_driver=False)

        def without_core():
            return sum(group["state"] == "REMOVED" for group in placement_group_table().values())

        before = without_core()
        cluster.remove_node(victim, allow_graceful=False)
        # Its collector finds no core, and is given up: nobody drives the turn again.
        wait_for(driver, lambda: without_core() > before)
    finally:
        ray.shutdown()
        os.kill(learner, signal.SIGCONT)
    before = step(out)
    cluster.add_node(num_cpus=1, node_ip_address="127.0.0.1")
    wait_for(driver, lambda: step(out) > before)
    assert processes("ray::Learner") == [learner], "the learner goes on"
    driver.send_signal(signal.SIGINT)
    said = finish(driver, 4)
    assert "the learner died" not in said
    last = saved(out) + 200
    assert_trained(out, finish(start(MORE, out, "--steps", str(last), "--resume")), last)


def test_a_sumo_that_hangs_is_ended_with_its_collector(nodes, start, tmp_path):
    """For longer than a turn may take: without --task-timeout the SUMO would be given up after a minute."""
    out = tmp_path / "out"
    driver = start([*COMMAND, "--task-timeout", "40"], out, "--steps", str(STEPS))
    collector, hung = at_work(driver, out)
    for sumo in hung:
        os.kill(sumo, signal.SIGSTOP)
    wait_for(driver, lambda: processes("ray::Collector") not in ([], [collector]))
    assert until(lambda: not set(hung) & set(processes("sumo"))), "the SUMO that hangs is left"
    said = finish(driver)
    assert "the learner died" not in said and " 1 restarts" in said
    assert_trained(out, said)


@pytest.mark.parametrize("file", ["train.jsonl", "checkpoint.pt"])
def test_a_full_disk_at_the_driver_costs_the_steps_since_the_last_checkpoint(nodes, start, tmp_path, file):
    out = tmp_path / "out"
    if file == "train.jsonl":
        # It is full before the first checkpoint, which would not fit either.
        command = [*COMMAND, "--checkpoint-every", "1000000", "--steps", str(STEPS)]
        said = finish(start(command, out, limit=6000), 1)
    else:
        first = start(COMMAND, out, "--steps", str(STEPS))
        wait_for(first, lambda: saved(out))
        first.send_signal(signal.SIGINT)
        assert "--resume goes on" in finish(first, 4)
        # There is room for some hundred transitions more.
        limit = (out / file).stat().st_size + 20_000
        said = finish(start(MORE, out, "--steps", str(2 * STEPS), "--resume", limit=limit), 1)
    assert f"error: cannot write {out / file}" in said and "--resume goes on" in said
    assert not list(out.glob("*.part")), "what could not be written takes room"
    assert until(lambda: not processes("sumo")), "a SUMO is left"
    before = saved(out)
    assert (before > 0) == (file == "checkpoint.pt"), "the last checkpoint stays"
    last = max(STEPS, before + 800)
    assert_trained(out, finish(start(MORE, out, "--steps", str(last), "--resume")), last)
    assert saved(out) > before


def test_a_folder_of_train_agent_is_left_alone(tmp_path):
    (tmp_path / "config.json").write_text("{}")
    for resume, text in ((False, "holds a training already"), (True, "no training of this program")):
        with pytest.raises(wad_cosim.InputError, match=text):
            Folder(tmp_path, Settings(), resume)
    assert (tmp_path / "config.json").read_text() == "{}"


def test_the_learners_answers_count_in_their_order(monkeypatch):
    """A later one may be on the driver's node first; counted then, steps would go back."""
    from wad_cosim.ray import training

    run, taken = object.__new__(training._Run), []
    run._bar = types.SimpleNamespace(is_due=lambda: False)
    run._learning, run._driving = {"first": 1, "second": 2}, {}
    run._learned = lambda ref: taken.append(run._learning.pop(ref))
    monkeypatch.setattr(training.ray, "wait", lambda refs, **_: (refs[-1:], refs[:-1]))
    run._go(10)
    run._go(10)
    assert taken == [1, 2]


#: Two stages, the first of which is left after its steps.
CURRICULUM = {
    "town": "town3",
    "weathers": ["ClearNoon"],
    "replay": 0.5,
    "stages": [
        {"task": "straight", "threshold": 1.0, "window": 50, "most_steps": 400},
        {"task": "one_turn", "threshold": 1.0, "window": 50},
    ],
}


def test_sumo_dies_and_collector_and_learner_hang_on_the_way_through_a_curriculum(nodes, start, tmp_path):
    out, file = tmp_path / "out", tmp_path / "curriculum.json"
    file.write_text(json.dumps(CURRICULUM))
    driver = start([*COMMAND, "--curriculum", str(file), "--task-timeout", "15"], out, "--steps", str(STEPS))
    collector, sumos = at_work(driver, out)
    for sumo in sumos:
        os.kill(sumo, signal.SIGKILL)
    before = step(out)
    wait_for(driver, lambda: step(out) > before)
    assert processes("ray::Collector") == [collector], "it goes on with another SUMO"
    # They hang for good: nothing wakes them.
    os.kill(collector, signal.SIGSTOP)
    wait_for(driver, lambda: processes("ray::Collector") not in ([], [collector]))
    before = step(out)
    wait_for(driver, lambda: step(out) > before and saved(out))
    (learner,) = processes("ray::Learner")
    os.kill(learner, signal.SIGSTOP)
    said = finish(driver)
    assert "on from the last checkpoint" in said and " 2 restarts" in said and "stage 1 (straight) is left, its steps are spent" in said
    assert not any(line.get("end") == "error" for line in log(out)), "SUMO's death is no episode"
    assert_trained(out, said)
    (passed,) = (line["passed"] for line in log(out) if "passed" in line)
    assert (passed["stage"], passed["threshold"]) == (0, False) and passed["step"] >= 400 and passed["hours"] > 0
    assert "one_turn" in {line["task"] for line in log(out) if "end" in line}
    if not PROGRAM.exists():
        pytest.skip(f"the rest needs {PROGRAM}: cargo build --release --workspace")
    subprocess.run([PROGRAM, "report", "learning", out, "--out", tmp_path / "report"], check=True)
    table = (tmp_path / "report" / "learning.md").read_text()
    assert "wad-t, raw, reward only" in table and f"{passed['step']} steps" in table and "its steps were spent" in table
