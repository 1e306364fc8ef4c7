"""Evaluation on Ray over hosts of their own: network namespaces on this machine, joined by a link that is cut."""

import contextlib
import json
import os
import pathlib
import subprocess
import sys
import time

import pytest
from conftest import until
from ray_cluster import MARK, finish, processes
from test_ray import AGENT, EPISODES, PART, assert_same, lines, one_machine  # noqa: F401

RAY = pathlib.Path(sys.executable).with_name("ray")
#: Checks in a row that a node does not answer, one every half second, after which it counts as dead.
CHECKS = 5
NET, PORT = "10.213.0", 6379


def quiet(*command):
    return subprocess.run(command, capture_output=True, text=True, check=True)


class Hosts:
    """Two hosts: a network and a /tmp/ray of its own each, and a link between them."""

    def __init__(self, stack):
        pathlib.Path("/tmp/ray").mkdir(exist_ok=True)
        self._stack, self._holders = stack, []
        for _ in range(2):
            # It keeps the host's namespaces, which end with it.
            self._holders.append(self._start("unshare", "--net", "--mount", "sleep", "infinity"))
        time.sleep(0.3)
        first, second = (str(holder.pid) for holder in self._holders)
        quiet("ip", "link", "add", "wad0", "netns", first, "type", "veth", "peer", "name", "wad0", "netns", second)
        for number in range(2):
            self.run(number, "mount", "-t", "tmpfs", "none", "/tmp/ray")
            self.run(number, "ip", "link", "set", "lo", "up")
            self.run(number, "ip", "addr", "add", f"{self.address(number)}/24", "dev", "wad0")
            self.up(number)
            # Ray finds its own address by the way to others.
            self.run(number, "ip", "route", "add", "default", "via", self.address(1 - number))

    def _start(self, *command, **more):
        process = subprocess.Popen(command, text=True, **more)
        self._stack.callback(process.wait)
        self._stack.callback(process.terminate)
        return process

    def address(self, number):
        return f"{NET}.{number + 1}"

    def on(self, number, *command):
        return ("nsenter", "--net", "--mount", f"--target={self._holders[number].pid}", "--", *map(str, command))

    def run(self, number, *command):
        return quiet(*self.on(number, *command))

    def start(self, number, *command, **more):
        return self._start(*self.on(number, *command), **more)

    def up(self, number):
        self.run(number, "ip", "link", "set", "wad0", "up")

    def down(self, number):
        self.run(number, "ip", "link", "set", "wad0", "down")


@pytest.fixture
def hosts(monkeypatch):
    """A Ray node of one core on each of two hosts; the first is the head."""
    monkeypatch.delenv("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", raising=False)
    monkeypatch.setenv(*MARK.split("="))
    with contextlib.ExitStack() as stack:
        try:
            made = Hosts(stack)
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f"this machine allows no network namespaces: {getattr(error, 'stderr', None) or error}")
        address = f"{made.address(0)}:{PORT}"
        health = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500, "health_check_timeout_ms": 500}
        health |= {"health_check_failure_threshold": CHECKS}
        head = ["--head", f"--port={PORT}", "--include-dashboard=false", f"--system-config={json.dumps(health)}"]
        log = subprocess.DEVNULL
        for number, options in enumerate((head, [f"--address={address}"])):
            options = ["start", "--block", "--num-cpus=1", f"--node-ip-address={made.address(number)}", *options]
            made.start(number, RAY, *options, stdout=log, stderr=log)
            assert until(lambda: _alive(made, address) == number + 1, 60)
        yield made, address
    assert until(lambda: not processes("ray")), "a worker is left"


def _alive(hosts, address):
    """Nodes that live, by the head."""
    code = f"import ray; ray.init({address!r}, log_to_driver=False); print(sum(node['Alive'] for node in ray.nodes()))"
    try:
        return int(hosts.run(0, sys.executable, "-c", code).stdout)
    except subprocess.CalledProcessError:
        return 0


@pytest.mark.parametrize("cut", ["for a moment", "until the node counts as dead"])
def test_a_link_that_is_cut_changes_nothing(hosts, one_machine, tmp_path, cut):
    made, address = hosts
    out = tmp_path / "out"
    options = [text for name, value in PART.items() for text in (f"--{name}", str(value))]
    command = ["-m", "wad_cosim.ray", "eval", "tasks", "--agent", AGENT, "--keep", "all", *options]
    command += ["--address", address, "--out", out]
    driver = made.start(0, sys.executable, *command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert until(lambda: (lines(out) and len(processes("sumo")) == 2) or driver.poll() is not None, 60)
    assert driver.poll() is None, finish(driver)
    made.down(1)
    assert len(lines(out)) < EPISODES
    if cut == "for a moment":
        time.sleep(CHECKS * 0.5 / 5)
    else:
        assert until(lambda: _alive(made, address) == 1, 60)
    made.up(1)
    finish(driver)
    # No SUMO is left on the host that was cut off either.
    assert_same(out, one_machine)
    assert _alive(made, address) == (2 if cut == "for a moment" else 1)
