"""Evaluation and training on Ray over hosts of their own: network namespaces on this machine, joined by a link that is cut."""

import contextlib
import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest
from conftest import until
from ray_cluster import MARK, finish, processes
from test_ray import AGENT, EPISODES, PART, assert_same, lines, one_machine  # noqa: F401
from test_train import COMMAND, MORE, assert_trained, saved, step, wait_for

RAY = pathlib.Path(sys.executable).with_name("ray")
#: Checks in a row that a node does not answer, one every half second, after which it counts as dead.
CHECKS = 5
NET, PORT = "10.213.0", 6379


def quiet(*command):
    return subprocess.run(command, capture_output=True, text=True, check=True)


class Hosts:
    """Two hosts: a network and a /tmp/ray of its own each, and a link between them. :meth:`join` makes them nodes of a cluster."""

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

    @property
    def cluster(self):
        return f"{self.address(0)}:{PORT}"

    def address(self, number):
        return f"{NET}.{number + 1}"

    def on(self, number, *command):
        return ("nsenter", "--net", "--mount", f"--target={self._holders[number].pid}", "--", *map(str, command))

    def run(self, number, *command):
        return quiet(*self.on(number, *command))

    def start(self, number, *command, **more):
        return self._start(*self.on(number, *command), **more)

    def join(self, number, cores):
        """Starts a Ray node on the host; the first is the cluster's head."""
        health = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500, "health_check_timeout_ms": 500}
        health |= {"health_check_failure_threshold": CHECKS}
        head = ["--head", f"--port={PORT}", "--include-dashboard=false", f"--system-config={json.dumps(health)}"]
        options = [f"--address={self.cluster}"] if number else head
        options = ["start", "--block", f"--num-cpus={cores}", f"--node-ip-address={self.address(number)}", *options]
        log = subprocess.DEVNULL
        self.start(number, RAY, *options, stdout=log, stderr=log)
        assert until(lambda: self.alive() == number + 1, 60)

    def alive(self):
        """Nodes that live, by the head."""
        code = f"import ray; ray.init({self.cluster!r}, log_to_driver=False); print(sum(node['Alive'] for node in ray.nodes()))"
        try:
            # Ray writes its own lines after it.
            return int(self.run(0, sys.executable, "-c", code).stdout.split()[0])
        except subprocess.CalledProcessError:
            return 0

    def drive(self, *command):
        """Starts a command of ``python -m wad_cosim.ray`` on the first host."""
        command = [sys.executable, "-m", "wad_cosim.ray", *command, "--address", self.cluster]
        return self.start(0, *command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def up(self, number):
        self.run(number, "ip", "link", "set", "wad0", "up")

    def down(self, number):
        self.run(number, "ip", "link", "set", "wad0", "down")


@pytest.fixture
def hosts(monkeypatch):
    """Two hosts, without a cluster yet."""
    monkeypatch.delenv("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", raising=False)
    monkeypatch.setenv(*MARK.split("="))
    with contextlib.ExitStack() as stack:
        try:
            made = Hosts(stack)
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f"this machine allows no network namespaces: {getattr(error, 'stderr', None) or error}")
        yield made
    assert until(lambda: not processes("ray")), "a worker is left"


@pytest.mark.parametrize("cut", ["for a moment", "until the node counts as dead"])
def test_a_link_that_is_cut_changes_nothing(hosts, one_machine, tmp_path, cut):
    out = tmp_path / "out"
    for number in range(2):
        hosts.join(number, 1)
    options = [text for name, value in PART.items() for text in (f"--{name}", str(value))]
    driver = hosts.drive("eval", "tasks", "--agent", AGENT, "--keep", "all", *options, "--out", out)
    assert until(lambda: (lines(out) and len(processes("sumo")) == 2) or driver.poll() is not None, 60)
    assert driver.poll() is None, finish(driver)
    hosts.down(1)
    assert len(lines(out)) < EPISODES
    if cut == "for a moment":
        time.sleep(CHECKS * 0.5 / 5)
    else:
        assert until(lambda: hosts.alive() == 1, 60)
    hosts.up(1)
    finish(driver)
    # No SUMO is left on the host that was cut off either.
    assert_same(out, one_machine)
    assert hosts.alive() == (2 if cut == "for a moment" else 1)


def test_a_training_goes_on_without_the_collector_that_is_cut_off(hosts, tmp_path):
    out = tmp_path / "out"
    # Learner and one collector fill the first host; the other collector comes to the second.
    hosts.join(0, 2)
    # So many steps that it is not done before, however fast the machine is.
    driver = hosts.drive(*COMMAND, "--workers", "2", "--steps", "1000000", "--out", out)
    wait_for(driver, lambda: step(out) > 0)
    assert len(processes("sumo")) == 1
    hosts.join(1, 1)
    wait_for(driver, lambda: len(processes("sumo")) == 2)
    hosts.down(1)
    wait_for(driver, lambda: hosts.alive() == 1)
    before = saved(out)
    wait_for(driver, lambda: saved(out) > before)
    assert len(processes("sumo")) == 2, "the host that is cut off knows nothing yet"
    hosts.up(1)
    wait_for(driver, lambda: len(processes("sumo")) == 1)
    driver.send_signal(signal.SIGINT)
    said = finish(driver, 4)
    assert "--resume goes on" in said and "the learner died" not in said
    steps = saved(out) + 200
    assert_trained(out, finish(hosts.drive(*MORE, "--steps", str(steps), "--resume", "--out", out)), steps)
    assert hosts.alive() == 1
