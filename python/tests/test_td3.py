"""An agent that PyTorch trained, as a file."""

import pathlib
import subprocess
import sys

import numpy as np
import pytest

import wad_cosim

EXAMPLES = pathlib.Path(__file__).parents[1] / "examples"
PROGRAM = pathlib.Path(__file__).parents[2] / "target" / "release" / "wad-cosim"
SIZES = {
    "raw": [(15, 50), (50, 100), (100, 75), (75, 3)],
    "latent": [(200, 150), (150, 100), (15, 50), (150, 100), (100, 75), (75, 3)],
    "vector": [(172, 150), (150, 100), (15, 50), (150, 100), (100, 75), (75, 3)],
}


def drawn(observation, rng):
    """Layers whose numbers half precision keeps."""
    half = lambda *shape: rng.normal(0, 0.1, shape).astype(np.float16).astype(np.float32)  # noqa: E731
    return [(half(outputs, inputs), half(outputs)) for inputs, outputs in SIZES[observation]]


def passed(layers, observation, x):
    """The paper's actor in NumPy."""
    relu = lambda layer, x: np.maximum(layer[0] @ x + layer[1], 0)  # noqa: E731
    if observation == "raw":
        x, rest = relu(layers[0], x), layers[1:]
    else:
        latent, raw = x[:-15], x[-15:]
        x = np.concatenate([relu(layers[1], relu(layers[0], latent)), relu(layers[2], raw)])
        rest = layers[3:]
    for layer in rest[:-1]:
        x = relu(layer, x)
    x = rest[-1][0] @ x + rest[-1][1]
    return np.array([np.tanh(x[0]), *(1 / (1 + np.exp(-x[1:])))])


@pytest.mark.parametrize("observation", SIZES)
def test_a_saved_agent_acts_as_its_layers(tmp_path, observation):
    rng = np.random.default_rng(4)
    layers = drawn(observation, rng)
    path = tmp_path / "agent.safetensors"
    wad_cosim.save_agent(path, layers, observation=observation, steps=7, params={"gamma": 0.9})
    agent = wad_cosim.load_agent(path)
    assert agent.observation == observation
    for _ in range(10):
        numbers = rng.normal(0, 1, layers[0][0].shape[1] + 15 * (observation != "raw")).astype(np.float32)
        assert np.abs(agent.act(numbers) - passed(layers, observation, numbers)).max() < 1e-5


def test_layers_that_do_not_fit_are_refused(tmp_path):
    path, rng = tmp_path / "agent.safetensors", np.random.default_rng(4)
    layers = drawn("raw", rng)
    broken = [(np.full_like(weights, np.nan), biases) for weights, biases in layers]
    for wrong, kwargs, text in (
        (layers[1:], {}, r"expected \[\(15, 50\)"),
        ([(weights.T, biases) for weights, biases in layers], {}, "layer 0"),
        (layers, {"observation": "latent"}, r"expected \[\(200, 150\)"),
        (layers, {"observation": "image"}, "raw, vector, latent"),
        (layers, {"params": {"gama": 0.9}}, "gama"),
        (layers, {"scores": {"a": object()}}, "wrong type"),
        (layers, {"encoder": "nobody's"}, "nobody's"),
        (broken, {}, "not finite"),
    ):
        with pytest.raises(wad_cosim.InputError, match=text):
            wad_cosim.save_agent(path, wrong, **kwargs)
        assert not path.exists()
    with pytest.raises(wad_cosim.InputError, match="cannot write"):
        wad_cosim.save_agent(tmp_path / "none" / "agent.safetensors", layers)


def test_the_example_writes_an_agent_that_drives(tmp_path):
    torch = pytest.importorskip("torch")
    # Its command line: torch and the simulator in one process, as users have them.
    path = tmp_path / "agent.safetensors"
    command = [sys.executable, EXAMPLES / "td3.py", "--out", path, "--episodes", "1"]
    command += ["--steps", "400", "--learning-starts", "200"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "of 1 episodes" in done.stdout

    # Its weights, rounded as the file rounds them, act as the file does.
    sys.path.insert(0, str(EXAMPLES))
    try:
        import td3
    finally:
        sys.path.remove(str(EXAMPLES))
    torch.manual_seed(3)
    actor = td3.Actor().half().float()
    actor.save(path)
    agent = wad_cosim.load_agent(path)
    for numbers in np.random.default_rng(1).normal(0, 1, (20, 15)).astype(np.float32):
        with torch.no_grad():
            expected = actor(torch.from_numpy(numbers)).numpy()
        assert np.abs(agent.act(numbers) - expected).max() < 1e-5

    if PROGRAM.exists():
        command = [PROGRAM, "run", "town3", "--agent", path, "--detector", "outlines", "--ticks", "20"]
        done = subprocess.run([*command, "--out", tmp_path / "run"], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
