"""Evaluation on Ray: the table of one machine, whatever dies on the way."""

import json
import os
import pathlib
import random
import signal
import time
import types

import pytest
from conftest import until
from ray_cluster import children, cluster, finish, listeners, nodes, processes, raylet, seconds, start  # noqa: F401

import wad_cosim
from wad_cosim import _native
from wad_cosim.evaluation import wanted_by
from wad_cosim.ray import evaluation

PART = {"condition": "development", "task": "obstacle", "weather": "ClearNoon", "seed": 3, "episodes": 8}
AGENT = "constant:0.3,0,0"
NO_MORE = {"town": (), "traffic": (), "resume": False}
EPISODES = PART["episodes"]
#: Which of the nodes dies, and after how many episodes: the same in every run.
SCHEDULE = random.Random(22)
#: What a full disk is in these tests (bytes): the settings and some episodes fit.
LIMIT = 6000


def lines(out):
    """The episodes' lines, in no order: they come as episodes end."""
    file = out / "episodes.jsonl"
    return sorted(file.read_bytes().splitlines(keepends=True)) if file.exists() else []


def assert_same(out, one_machine):
    """Nothing lost, nothing twice, the same table; and nothing left running."""
    assert lines(out) == lines(one_machine) and len(lines(out)) == EPISODES
    for name in ("config.json", "summary.json"):
        assert (out / name).read_bytes() == (one_machine / name).read_bytes()
    assert until(lambda: not processes("sumo")), "a SUMO is left"


@pytest.fixture(scope="module")
def one_machine(tmp_path_factory):
    out = tmp_path_factory.mktemp("one") / "machine"
    wad_cosim.evaluate("tasks", AGENT, **PART, out=out, keep="all")
    return out


@pytest.fixture
def drive(start):
    """Starts the evaluation."""
    options = [text for name, value in PART.items() for text in (f"--{name}", str(value))]
    command = ["eval", "tasks", "--agent", AGENT, "--keep", "all", *options]
    return lambda out, *more, limit=None: start(command, out, *more, limit=limit)


def kill_worker(cluster, node):
    assert until(lambda: children(raylet(node), "sumo"))
    for worker in children(raylet(node), "ray::Worker"):
        os.kill(worker, signal.SIGKILL)


def kill_sumo(cluster, node):
    assert until(lambda: children(raylet(node), "sumo"))
    for sumo in children(raylet(node), "sumo"):
        os.kill(sumo, signal.SIGKILL)


def stop_sumo(cluster, node):
    """It hangs for longer than an episode may take: its worker is ended, and it with its worker."""
    assert until(lambda: children(raylet(node), "sumo"))
    for sumo in children(raylet(node), "sumo"):
        os.kill(sumo, signal.SIGSTOP)


def stop_worker(cluster, node):
    """It hangs for good, while its node lives."""
    assert until(lambda: children(raylet(node), "sumo"))
    for worker in children(raylet(node), "ray::Worker"):
        os.kill(worker, signal.SIGSTOP)


def kill_node(cluster, node):
    cluster.remove_node(node, allow_graceful=False)


def stop_node(cluster, node):
    """It hangs until it counts as dead, and comes back."""
    stopped = [raylet(node), *children(raylet(node), "ray::Worker"), *children(raylet(node), "sumo")]
    for pid in stopped:
        os.kill(pid, signal.SIGSTOP)
    import ray

    ray.init(cluster.address, log_to_driver=False)
    try:
        assert until(lambda: sum(found["Alive"] for found in ray.nodes()) == 2)
    finally:
        ray.shutdown()
        for pid in stopped:
            os.kill(pid, signal.SIGCONT)
    # Ray's part of it ends itself, since the cluster goes on without it. Its workers end when it is gone; a zombie is not.
    node.all_processes["raylet"][0].process.wait(30)
    cluster.remove_node(node, allow_graceful=False)


@pytest.mark.parametrize("fault", [kill_worker, kill_sumo, stop_sumo, stop_worker, kill_node, stop_node])
def test_a_death_on_the_way_changes_nothing(cluster, nodes, drive, one_machine, tmp_path, fault):
    out = tmp_path / "out"
    victim, after = SCHEDULE.choice(nodes), SCHEDULE.randrange(1, 4)
    driver = drive(out, "--task-timeout", "15")
    assert until(lambda: len(lines(out)) >= after or driver.poll() is not None, 60)
    assert driver.poll() is None, finish(driver)
    fault(cluster, victim)
    finish(driver)
    assert_same(out, one_machine)


def test_a_worker_without_a_core_is_stopped_so_that_ray_rests(cluster, nodes):
    """Ray looks without a pause for the core of an actor that has lost its own, with a core of its own."""
    import ray
    from wad_cosim.ray.cluster import Actors

    class Idle:
        def here(self):
            return True

    ray.init(cluster.address, log_to_driver=False)
    try:
        actors = Actors(60)
        ours = [actors.start(Idle, max_restarts=-1, max_task_retries=-1) for _ in nodes]
        assert ray.get([one.here.remote() for one in ours]) == [True, True]
        # Not the one that this process belongs to.
        here = ray.get_runtime_context().get_node_id()
        kill_node(cluster, next(node for node in nodes if node.node_id != here))
        assert until(lambda: actors.look() or any(map(actors.lost, ours)), 60)
        assert sum(map(actors.lost, ours)) == 1
        before, since = seconds(*processes("gcs_server")), time.monotonic()
        time.sleep(3)
        assert seconds(*processes("gcs_server")) - before < 0.5 * (time.monotonic() - since)
        # Another waits, until a node comes.
        other = actors.start(Idle)
        answer = other.here.remote()
        assert not ray.wait([answer], timeout=1)[0]
        cluster.add_node(num_cpus=1)
        assert ray.get(answer, timeout=60)
        actors.stop_all()
    finally:
        ray.shutdown()


def test_a_worker_that_hangs_before_its_first_episode_is_started_again(cluster, nodes, one_machine, tmp_path):
    out, mark = tmp_path / "out", tmp_path / "hung"

    def unpickle():
        if not mark.exists():
            mark.touch()
            time.sleep(1000)
        return None

    class Hangs:
        """What a worker gets in place of None."""

        def __reduce__(self):
            return unpickle, ()

    wanted = wanted_by("tasks", [AGENT], **PART, **NO_MORE, detector=_native.DEFAULT_DETECTOR, out=out, keep="all")
    evaluation.evaluate(wanted, Hangs(), address=cluster.address, limit=20)
    assert mark.exists()
    assert_same(out, one_machine)


#: 127.0.0.1, ::1, and the first in IPv6's way.
LOOPBACK = {"0100007F", "00000000000000000000000001000000", "0000000000000000FFFF00000100007F"}


def test_local_needs_no_cluster_and_is_closed_to_others(drive, one_machine, tmp_path):
    out, before = tmp_path / "out", set(processes(""))
    driver = drive(out, "--address", "local", "--workers", "1")
    assert until(lambda: lines(out) or driver.poll() is not None, 60)
    ours = set(processes("")) - before - set(processes("sumo"))
    assert {"raylet", "gcs_server"} <= {pathlib.Path(f"/proc/{pid}/exe").resolve().name for pid in ours}
    assert listeners(ours) and listeners(ours) <= LOOPBACK
    said = finish(driver)
    assert f"{EPISODES}/{EPISODES} episodes, " in said and " an hour, 0 s left, 1 nodes, 0 restarts" in said
    assert_same(out, one_machine)


def test_a_driver_that_dies_is_resumed_and_another_is_refused(nodes, drive, one_machine, tmp_path):
    out = tmp_path / "out"
    first = drive(out)
    assert until(lambda: len(lines(out)) >= 1, 60)
    # It stands still, else it might be done before the other has started.
    first.send_signal(signal.SIGSTOP)
    assert "another process" in finish(drive(out, "--resume"), 2)
    first.kill()
    first.wait()
    assert until(lambda: not processes("sumo")), "a SUMO outlives the driver"
    before = len(lines(out))
    second = drive(out, "--resume")
    assert until(lambda: len(lines(out)) > before, 60)
    second.send_signal(signal.SIGINT)
    assert "--resume goes on" in finish(second, 4)
    done = len(lines(out))
    assert json.loads((out / "summary.json").read_text())["episodes"] == done > before
    finish(drive(out, "--resume"))
    assert_same(out, one_machine)


#: It also starts a process that would outlive it: in a session of its own, and deaf to its end of input.
EXTERNAL = """exec:setsid sleep 1000 & echo '{}'; while read -r line; do echo '{"throttle": 0.3, "steer": 0, "brake": 0}'; done"""


def test_an_external_agent_leaves_no_process_however_its_worker_ends(cluster, nodes, start, tmp_path):
    one, out = tmp_path / "one", tmp_path / "out"
    wad_cosim.evaluate("tasks", EXTERNAL, **PART, out=one, keep="all")
    assert not processes("sleep"), "the evaluation here left a process"
    options = [text for name, value in PART.items() for text in (f"--{name}", str(value))]
    command = ["eval", "tasks", "--agent", EXTERNAL, "--keep", "all", *options]

    def until_driven(driver, episodes):
        assert until(lambda: len(lines(out)) >= episodes or driver.poll() is not None, 60)
        assert driver.poll() is None, finish(driver)
        assert processes("sleep")

    first = start(command, out)
    until_driven(first, 1)
    first.kill()
    first.wait()
    assert until(lambda: not processes("sleep")), "an agent's process outlives the driver"
    second = start(command, out, "--resume")
    until_driven(second, len(lines(out)) + 1)
    second.send_signal(signal.SIGINT)
    assert "--resume goes on" in finish(second, 4)
    assert until(lambda: not processes("sleep")), "an agent's process outlives Ctrl-C"
    third = start(command, out, "--resume")
    assert until(lambda: processes("sleep") or third.poll() is not None, 60)
    kill_worker(cluster, SCHEDULE.choice(nodes))
    finish(third)
    assert until(lambda: not processes("sleep")), "an agent's process outlives its worker"
    assert_same(out, one)


def test_a_full_disk_at_the_driver_costs_the_rest_only(nodes, drive, one_machine, tmp_path):
    out = tmp_path / "out"
    # Recordings are larger than some lines: without them it is a line that does not fit.
    said = finish(drive(out, "--keep", "none", limit=LIMIT), 1)
    assert "episodes.jsonl" in said
    kept = lines(out)
    assert 0 < len(kept) < EPISODES and all(line.endswith(b"\n") for line in kept)
    finish(drive(out, "--resume", "--keep", "all"))

    def results(folder):
        return sorted(str({**json.loads(line), "recording": None}) for line in lines(folder))

    assert results(out) == results(one_machine)
    assert (out / "summary.json").read_bytes() == (one_machine / "summary.json").read_bytes()


def test_python_asks_for_ray(cluster, nodes, one_machine, tmp_path):
    out = tmp_path / "out"
    table = wad_cosim.evaluate("tasks", AGENT, **PART, out=out, keep="all", ray=cluster.address)
    assert len(table) == 1
    assert_same(out, one_machine)
    recordings = sorted(path.relative_to(out) for path in (out / "episodes").rglob("*") if path.is_file())
    assert len(recordings) == 2 * EPISODES
    for name in recordings:
        assert (out / name).read_bytes() == (one_machine / name).read_bytes()
    with pytest.raises(wad_cosim.InputError, match="holds results already"):
        wad_cosim.evaluate("tasks", AGENT, **PART, out=out, ray=cluster.address)

    def broken(_):
        raise ZeroDivisionError("by hand")

    import ray
    from ray.util.placement_group import placement_group_table

    # In a session of the user's own: nothing of it stays.
    ray.init(cluster.address, log_to_driver=False)
    try:
        with pytest.raises(ZeroDivisionError, match="by hand"):
            wad_cosim.evaluate("tasks", broken, detector="outlines", **PART, ray=cluster.address)
        assert until(lambda: {group["state"] for group in placement_group_table().values()} == {"REMOVED"}), "a core is kept"
    finally:
        ray.shutdown()


def test_what_waits_for_its_turn_is_not_late(monkeypatch):
    from wad_cosim.ray import cluster

    now, ended = [0.0], []
    monkeypatch.setattr(cluster, "time", types.SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(cluster, "placement_group_table", lambda: {"00": {"state": "CREATED"}})
    monkeypatch.setattr(cluster.ray, "kill", lambda actor, no_restart: ended.append(actor))
    actors = cluster.Actors(10)
    actors._cores["learner"] = types.SimpleNamespace(id=b"\0")
    for ref in "abcd":
        actors.begin(ref, "learner")
    for ref in "abc":
        now[0] += 8
        actors.look()
        actors.end(ref)
    assert not ended, "each has taken 8 of its 10 seconds"
    now[0] += 10
    actors.look()
    assert ended == ["learner"]


def test_an_episode_counts_once_and_is_driven_by_the_same_build(tmp_path):
    part = {**PART, **NO_MORE, "episodes": 1}
    wanted = wanted_by("tasks", [AGENT], **part, detector="truth", out=tmp_path / "a", keep="all")
    ledger = _native.Ledger(json.dumps(wanted), None)
    (case,) = ledger.left()
    worker = _native.Worker(ledger.manifest, "default", "all", 10.0, None)
    driven = worker.drive(case)
    assert driven == worker.drive(case), "equal cases give equal bytes"
    assert [ledger.add(*driven), ledger.add(*driven)] == [True, False] and not ledger.left()
    assert len(lines(tmp_path / "a")) == 1
    foreign = json.loads(driven[0]) | {"episode": 7}
    with pytest.raises(wad_cosim.Error, match="not in this evaluation's plan"):
        ledger.add(json.dumps(foreign).encode(), None)
    manifest = json.loads(ledger.manifest) | {"build": "0.0.1 (elsewhere)"}
    with pytest.raises(wad_cosim.InputError, match=r"build: expected \"0.0.1 \(elsewhere\)"):
        _native.Worker(json.dumps(manifest), "default", "all", 10.0, None).drive(case)
    ledger.finish()
    with pytest.raises(wad_cosim.Error, match="finished"):
        ledger.left()


def test_shards_are_collected_once_whatever_dies(cluster, nodes, start, tmp_path):
    wanted = {"town": "town3", "frames": 12, "per_shard": 3, "seed": 5, "every": 0.5, "camera": False}
    wanted |= {"weathers": [], "noise_pause": None, "out": str(tmp_path / "one")}
    one = _native.Collection(json.dumps(wanted))
    collector = _native.Collector(json.dumps(wanted), one.identity)
    for segment in one.missing()[0]:
        shard = collector.drive(segment)
        assert one.put(segment, shard) and not one.put(segment, shard)
    with pytest.raises(wad_cosim.InputError, match="segment"):
        other = json.loads(segment) | {"index": 4}
        one.put(json.dumps(other), shard)
    assert json.loads(one.finish(False))["complete"]

    out = tmp_path / "out"
    options = [text for name in ("frames", "seed") for text in (f"--{name}", str(wanted[name]))]
    command = ["collect", "--per-shard", "3", *options]
    driver = start(command, out)
    assert until(lambda: list(out.glob("*.wads")) or driver.poll() is not None, 60)
    assert driver.poll() is None, finish(driver)
    kill_worker(cluster, SCHEDULE.choice(nodes))
    driver.send_signal(signal.SIGINT)
    assert "continues from here" in finish(driver, 4)
    assert until(lambda: not processes("sumo")), "a SUMO is left"
    assert "12 frames in 4 shards" in finish(start(command, out))
    files = sorted(path.name for path in out.glob("[!.]*"))
    assert files == sorted(path.name for path in (tmp_path / "one").glob("[!.]*")) and len(files) == 5
    for name in files:
        assert (out / name).read_bytes() == (tmp_path / "one" / name).read_bytes()
