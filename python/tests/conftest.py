"""What the tests share."""

import os
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import pytest

import wad_cosim  # noqa: F401  registers the ids

# PyTorch has one thread, here and in what tests start: networks this small gain nothing by more, and tests share their cores.
os.environ["OMP_NUM_THREADS"] = "1"

# A shell starts what runs in the background with Ctrl-C ignored, and all that it starts inherits that: tests that press it
# would wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def make() -> Iterator[Callable[..., Any]]:
    """``gymnasium.make`` of an id's name, closed after the test."""
    made = []

    def make(name: str = "Straight", **kwargs: Any) -> Any:
        env = gymnasium.make(f"wad_cosim/{name}-v0", **kwargs)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    """A warning of Gymnasium's checks fails a test."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        yield


def sumos() -> list[int]:
    """SUMO processes that this process started and that still run."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/stat") as stat:
                name, rest = stat.read().split("(", 1)[1].rsplit(")", 1)
        except OSError:
            continue
        state, parent = rest.split()[:2]
        if name == "sumo" and int(parent) == os.getpid() and state != "Z":
            found.append(int(pid))
    return found


def until(what: Callable[[], bool], seconds: float = 20) -> bool:
    """Whether ``what`` becomes true."""
    end = time.monotonic() + seconds
    while not what():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True
