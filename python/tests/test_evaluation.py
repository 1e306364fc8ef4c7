"""Benchmarks, as the command line drives them."""

import json
import pathlib
import pickle
import subprocess
import time

import numpy as np
import pytest

import wad_cosim

PART = {"condition": "development", "task": "obstacle", "episodes": 2, "weather": "ClearNoon", "seed": 3}
PROGRAM = pathlib.Path(__file__).parents[2] / "target" / "release" / "wad-cosim"


def rows(table):
    """The rows, whether pandas is installed or not."""
    return table if isinstance(table, list) else table.to_dict("records")


def test_the_same_bytes_as_the_command_line(tmp_path):
    if not PROGRAM.exists():
        pytest.skip("the program is not built: cargo build --release")
    constant = "constant:0.3,0,0"
    wad_cosim.evaluate("tasks", constant, **PART, mirrors=True, out=tmp_path / "python", keep="none")
    command = [PROGRAM, "eval", "tasks", "--agent", constant, "--mirrors", "--out", tmp_path / "program", "--keep", "none"]
    for option, value in PART.items():
        command += [f"--{option}", str(value)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name in ("episodes.jsonl", "summary.json"):
        ours, theirs = ((tmp_path / where / name).read_bytes() for where in ("python", "program"))
        assert ours == theirs and ours
    for where in ("python", "program"):
        assert json.loads((tmp_path / where / "config.json").read_bytes())["options"]["mirrors"]


@pytest.mark.parametrize("observation", ["raw", "vector"])
def test_a_function_is_judged(tmp_path, observation):
    seen = []

    def crawl(numbers):
        seen.append(numbers)
        return np.float32([0, 0.3, 0])

    out = tmp_path / "results"
    table = rows(wad_cosim.evaluate("tasks", crawl, observation=observation, detector="outlines", **PART, out=out))
    assert len(table) == 1 and table[0]["agent"] == "crawl"
    assert table[0]["episodes"] == 2 and 0 <= table[0]["interval"][0] <= table[0]["interval"][1] <= 1
    space = wad_cosim.DrivingEnv(task="straight", observation=observation).observation_space
    assert all(space.contains(numbers) for numbers in seen)
    lines = (out / "episodes.jsonl").read_text().splitlines()
    assert len(lines) == 2 and json.loads(lines[0])["agent"] == "crawl"
    # What is done is not driven again.
    count = len(seen)
    wad_cosim.evaluate("tasks", crawl, observation=observation, detector="outlines", **PART, out=out, resume=True)
    assert len(seen) == count
    with pytest.raises(wad_cosim.InputError, match="holds results already"):
        wad_cosim.evaluate("tasks", crawl, observation=observation, detector="outlines", **PART, out=out)
    assert "crawl" in wad_cosim.report(out)
    assert "| slow |" in wad_cosim.report(out, pools={"slow": ["crawl"]})
    with pytest.raises(wad_cosim.InputError, match="no run has the agent fast; there are crawl"):
        wad_cosim.report(out, pools={"slow": ["fast"]})


def test_a_policy_that_predicts_is_judged():
    class Policy:
        begun = 0

        def reset(self):
            self.begun += 1

        def predict(self, observation, deterministic=False):
            assert deterministic
            return 8, None

    policy = Policy()
    table = rows(wad_cosim.evaluate("tasks", policy, action="discrete", detector="outlines", **PART))
    assert table[0]["agent"] == "Policy" and policy.begun == 2
    with pytest.raises(wad_cosim.InputError, match="jobs=2: the agent has a method `reset`"):
        wad_cosim.evaluate("tasks", policy, action="discrete", detector="outlines", **PART, jobs=2)


def test_several_jobs_call_the_agent_one_at_a_time():
    inside = []

    def slow(_):
        inside.append(True)
        time.sleep(0.002)
        assert len(inside) == 1
        inside.pop()
        return [0, 0.3, 0]

    assert rows(wad_cosim.evaluate("tasks", slow, detector="outlines", **PART, jobs=2))[0]["episodes"] == 2


def test_an_exception_of_the_agent_comes_through():
    def broken(_):
        raise ZeroDivisionError("by hand")

    with pytest.raises(ZeroDivisionError, match="by hand"):
        wad_cosim.evaluate("tasks", broken, detector="outlines", **PART)
    with pytest.raises(wad_cosim.InputError, match="shape"):
        wad_cosim.evaluate("tasks", lambda _: [1, 2], detector="outlines", **PART)


@pytest.mark.parametrize(
    ("suite", "kwargs", "text"),
    [
        ("nocash", {}, "corl2017"),
        ("tasks", {"condition": "paris"}, "paris"),
        ("tasks", {"agent": "wad-z"}, "wad-z"),
        ("tasks", {"keep": "some"}, "failures"),
        ("tasks", {"agent": 3}, "predict"),
        ("tasks", {"observation": "lidar"}, "raw, vector, latent"),
        ("tasks", {"detector": "lidar"}, "no detector has this name"),
    ],
)
def test_wrong_arguments_say_what_is_expected(suite, kwargs, text):
    with pytest.raises(wad_cosim.InputError, match=text):
        wad_cosim.evaluate(suite, **kwargs)


def test_bundled_agents_act_without_libtorch():
    agent = wad_cosim.load_agent("wad-t")
    assert agent.observation == "latent"
    action = agent.act(np.zeros(215))
    assert action.shape == (3,) and -1 <= action[0] <= 1 and (action[1:] >= 0).all() and (action[1:] <= 1).all()
    with pytest.raises(wad_cosim.InputError, match="expected 215"):
        agent.act(np.zeros(15))
    for kwargs, text in (({"observation": "raw"}, "needs 'latent'"), ({"encoder": "pooled"}, "trained with the encoder")):
        with pytest.raises(wad_cosim.InputError, match=text):
            wad_cosim.evaluate("tasks", agent, **PART, **kwargs)
    for name in ("wad-z", __file__):
        with pytest.raises(wad_cosim.InputError):
            wad_cosim.load_agent(name)


def test_an_agent_of_the_latent_alone_takes_the_observation_of_an_environment(tmp_path):
    sizes, rng = [(200, 256), (256, 128), (128, 64), (64, 6)], np.random.default_rng(5)
    trained = {"inputs": "latent", "detector": "truth", "encoder": "default", "algorithm": {"algo": "sac"}, "scale": None}
    trained |= {"steps": 0, "updates": 0, "seed": 0, "scores": {}, "config": {}}
    values = np.concatenate([rng.normal(0, 0.1, n) for size in sizes for n in (size[0] * size[1], size[1])])
    path = tmp_path / "agent.safetensors"
    wad_cosim._native.save_agent(path, json.dumps(trained), sizes, values.astype(np.float32))
    agent = wad_cosim.load_agent(path)
    assert agent.observation == "latent"
    observation = rng.normal(0, 1, 215)
    assert agent(observation).tolist() == agent(observation[:200]).tolist()
    assert agent(observation).tolist() != agent(rng.normal(0, 1, 215)).tolist()


def test_a_trained_agent_travels_to_other_processes(tmp_path, monkeypatch):
    bundled = pathlib.Path(__file__).parents[2] / "models" / "wad_t" / "agent.safetensors"
    monkeypatch.chdir(tmp_path)
    pathlib.Path("agent.safetensors").write_bytes(bundled.read_bytes())
    observation = np.linspace(-1, 1, 215)
    for name in ("wad-t", pathlib.Path("agent.safetensors")):
        sent = pickle.dumps(wad_cosim.load_agent(name))
        monkeypatch.chdir("/")
        assert pickle.loads(sent)(observation).tolist() == wad_cosim.load_agent("wad-t")(observation).tolist()
        monkeypatch.chdir(tmp_path)


def test_a_program_over_a_pipe_is_judged_and_one_that_dies_costs_its_episode_only(tmp_path):
    script = pathlib.Path(__file__).parents[2] / "scripts" / "example_agent.py"
    good = f"exec:python3 {script}"
    dying = "exec:echo '{}'; read -r line; echo out of ideas >&2; exit 3"
    table = rows(wad_cosim.evaluate("tasks", good, **PART, out=tmp_path / "python", keep="none"))
    assert table[0]["agent"] == good and table[0]["agent_failures"] == 0 and table[0]["mean_distance_m"] > 3
    table = rows(wad_cosim.evaluate("tasks", dying, **PART, out=tmp_path / "dying"))
    assert table[0]["agent_failures"] == table[0]["episodes"] == 2
    assert "it died (exit status: 3); it said: out of ideas" in (tmp_path / "dying" / "episodes.jsonl").read_text()
    with pytest.raises(wad_cosim.InputError, match="agent_timeout"):
        wad_cosim.evaluate("tasks", good, **PART, agent_timeout=0)
    if PROGRAM.exists():
        command = [PROGRAM, "eval", "tasks", "--agent", good, "--out", tmp_path / "program", "--keep", "none"]
        for option, value in PART.items():
            command += [f"--{option}", str(value)]
        assert subprocess.run(command, capture_output=True).returncode == 0
        for name in ("episodes.jsonl", "summary.json"):
            assert (tmp_path / "program" / name).read_bytes() == (tmp_path / "python" / name).read_bytes()


def test_a_bundled_agent_drives_as_from_the_command_line(tmp_path):
    # The same camera, lanes, encoder and actor, without libtorch and OpenCV: by name, and by its own function.
    part = {**PART, "task": "straight", "weather": "WetCloudyNoon"}
    agent = wad_cosim.load_agent("wad-t")
    wad_cosim.evaluate("tasks", "wad-t", **part, out=tmp_path / "named", keep="none")
    called = wad_cosim.evaluate("tasks", agent, **part, out=tmp_path / "called")
    assert rows(called)[0]["successes"] == 2

    def drives(name):
        lines = (tmp_path / name / "episodes.jsonl").read_text().splitlines()
        return [{key: json.loads(line)[key] for key in ("end", "ticks", "distance_m")} for line in lines]

    assert drives("named") == drives("called") and len(drives("named")) == 2
    if PROGRAM.exists():
        command = [PROGRAM, "eval", "tasks", "--agent", "wad-t", "--out", tmp_path / "program", "--keep", "none"]
        for option, value in part.items():
            command += [f"--{option}", str(value)]
        assert subprocess.run(command, capture_output=True).returncode == 0
        theirs = (tmp_path / "program" / "episodes.jsonl").read_bytes()
        assert theirs == (tmp_path / "named" / "episodes.jsonl").read_bytes()
