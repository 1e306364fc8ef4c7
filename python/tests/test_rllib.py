"""The example of RLlib, where RLlib and PyTorch are installed."""

import pathlib
import re
import subprocess
import sys

import pytest

pytest.importorskip("torch")
pytest.importorskip("ray")
# What `ray[rllib]` asks for beside Ray.
pytest.importorskip("tree")


def test_the_example_trains_on_two_runners(tmp_path):
    example = pathlib.Path(__file__).parents[1] / "examples" / "rllib_ppo.py"
    command = [sys.executable, example, "--iterations", "2", "--batch", "400"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if line.startswith("iteration ")]
    numbers = [list(map(float, re.findall(r"-?[0-9]+\.?[0-9]*|nan", line))) for line in lines]
    assert len(numbers) == 2, done.stdout
    steps, returns, lengths, losses, episodes = zip(*(row[1:] for row in numbers))
    assert 400 <= steps[0] and 800 <= steps[1], "steps are counted"
    assert all(loss == loss and abs(loss) < 1e6 for loss in losses), "losses are numbers"
    assert episodes[-1] >= 1 and lengths[-1] > 0 and returns[-1] == returns[-1], "episodes ended"
