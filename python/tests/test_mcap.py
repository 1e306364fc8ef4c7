"""A drive as an MCAP file, read by MCAP's own reader."""

import base64
import json
import pathlib
import subprocess

import gymnasium
import numpy as np
import pytest
from mcap.reader import make_reader

import wad_cosim

PROGRAM = pathlib.Path(__file__).parents[2] / "target" / "release" / "wad-cosim"
SCHEMAS = {
    "/camera": "foxglove.CompressedImage",
    "/camera/calibration": "foxglove.CameraCalibration",
    "/camera/boxes": "foxglove.ImageAnnotations",
    "/map": "foxglove.SceneUpdate",
    "/traffic": "foxglove.SceneUpdate",
    "/ego": "foxglove.PoseInFrame",
    "/tf": "foxglove.FrameTransform",
    "/reward": "wad_cosim.Reward",
}


def read(path):
    """Messages by topic, in the order of their times; each has the fields of its schema."""
    found = {topic: [] for topic in SCHEMAS}
    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert schema.name == SCHEMAS[channel.topic]
            told, described = json.loads(message.data), json.loads(schema.data)
            assert described["title"] == schema.name
            if schema.name.startswith("foxglove."):
                assert told.keys() == described["properties"].keys()
            found[channel.topic].append((message.log_time, told))
    return found


def check(found, ticks):
    assert len(found["/map"]) == 1
    (town,) = found["/map"][0][1]["entities"]
    assert len(town["lines"]) > 100 and all(len(line["points"]) > 1 for line in town["lines"])
    for topic in ("/camera", "/camera/calibration", "/camera/boxes", "/traffic", "/ego", "/reward"):
        times = [time for time, _ in found[topic]]
        assert len(times) == ticks and all(a < b for a, b in zip(times, times[1:])), topic
    assert len(found["/tf"]) == 2 * ticks
    picture = base64.b64decode(found["/camera"][-1][1]["data"])
    assert picture[:3] == b"\xff\xd8\xff" and found["/camera"][-1][1]["format"] == "jpeg"
    for (_, here), (_, scene) in zip(found["/ego"], found["/traffic"]):
        ego, vehicles, pedestrians = scene["entities"]
        assert [each["id"] for each in scene["entities"]] == ["ego", "vehicles", "pedestrians"]
        spot, cube = here["pose"]["position"], ego["cubes"][0]["pose"]["position"]
        assert (spot["x"], spot["y"]) == (cube["x"], cube["y"])
    for _, terms in found["/reward"]:
        assert abs(sum(value for name, value in terms.items() if name != "total") - terms["total"]) < 1e-9
    return vehicles, pedestrians


def test_a_recording_from_python(tmp_path):
    path = tmp_path / "new" / "drive.mcap"
    env = gymnasium.make("wad_cosim/Composite-v0", record=path, tick_limit=12)
    rewards = []
    for seed in (1, 2):
        env.reset(seed=seed)
        over = False
        while not over:
            _, reward, terminated, truncated, _ = env.step(np.float32([0, 0.4, 0]))
            rewards.append(reward)
            over = terminated or truncated
    env.close()
    found = read(path)
    # The second episode's clock begins again; the file's goes on.
    check(found, 24)
    assert [terms["total"] for _, terms in found["/reward"]] == pytest.approx(rewards)


def test_a_recording_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(wad_cosim.InputError, match="cannot write"):
        gymnasium.make("wad_cosim/Straight-v0", record=tmp_path / "file" / "drive.mcap")
    with pytest.raises(wad_cosim.InputError, match="several egos in one SUMO have neither pictures"):
        wad_cosim.DrivingVectorEnv(2, egos=2, task="straight", record=tmp_path / "drive.mcap")


@pytest.mark.parametrize("observation", ["raw", "vector", "image", "transformed"])
def test_boxes_are_recorded_whatever_the_agent_observes(tmp_path, observation):
    path = tmp_path / "drive.mcap"
    env = gymnasium.make("wad_cosim/Composite-v0", record=path, tick_limit=12, observation=observation, traffic="dense")
    env.reset(seed=1)
    for _ in range(12):
        env.step(np.float32([0, 0.4, 0]))
    env.close()
    found = read(path)
    check(found, 12)
    boxes = [shown["points"] for _, shown in found["/camera/boxes"]]
    assert sum(map(len, boxes)) > 0
    assert all(0 <= corner["x"] <= 512 and 0 <= corner["y"] <= 512 for each in boxes for box in each for corner in box["points"])


def test_several_environments_have_a_recording_each(tmp_path):
    env = gymnasium.make_vec("wad_cosim/Straight-v0", num_envs=2, record=tmp_path / "drive.mcap", traffic="empty")
    env.reset(seed=1)
    for _ in range(5):
        env.step(np.tile(np.float32([0, 0.4, 0]), (2, 1)))
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive-0.mcap", "drive-1.mcap"]
    places = []
    for path in sorted(tmp_path.iterdir()):
        found = read(path)
        check(found, 5)
        places.append(found["/ego"][0][1]["pose"]["position"])
    assert places[0] != places[1]


def test_a_recording_of_the_program(tmp_path):
    if not PROGRAM.exists():
        pytest.skip("the program is not built: cargo build --release")
    path = tmp_path / "drive.mcap"
    command = [PROGRAM, "run", "town3", "--ticks", "15", "--traffic", "regular", "--out", tmp_path / "run"]
    done = subprocess.run([*command, "--record", path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    vehicles, _ = check(read(path), 15)
    assert isinstance(vehicles["cubes"], list)
