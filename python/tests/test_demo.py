"""The demonstration, as a user runs it."""

import subprocess
import sys


def test_the_demo_drives_and_writes_a_picture(tmp_path):
    command = [sys.executable, "-m", "wad_cosim.demo", "--ticks", "50", "--picture", "seen.png"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "50 ticks in" in done.stdout
    assert (tmp_path / "seen.png").read_bytes().startswith(b"\x89PNG")


def test_the_demo_says_what_is_wrong(tmp_path):
    command = [sys.executable, "-m", "wad_cosim.demo", "--town", "town33"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert "did you mean town3" in done.stderr and "Traceback" not in done.stderr


def test_the_bench_measures():
    done = subprocess.run(
        [sys.executable, "-m", "wad_cosim.bench", "--steps", "20"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "env.step" in done.stdout and "agent-steps/s" in done.stdout
