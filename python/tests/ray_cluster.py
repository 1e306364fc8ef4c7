"""A Ray cluster of a head and nodes on this machine, for tests that kill its parts."""

import contextlib
import os
import pathlib
import resource
import subprocess
import sys
import uuid

import pytest
from conftest import until

# Before Ray is imported: on loopback, and with a token of its own.
os.environ.update(
    RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER="0",
    RAY_AUTH_MODE="token",
    RAY_AUTH_TOKEN=uuid.uuid4().hex,
    RAY_USAGE_STATS_ENABLED="0",
)
pytest.importorskip("ray")
from ray.cluster_utils import Cluster  # noqa: E402

#: In the environment of every process of these tests.
MARK = f"WAD_COSIM_TEST={uuid.uuid4()}"


def processes(name):
    """Processes of these tests whose command begins with ``name``."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            command = pathlib.Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")[0].decode()
            marked = MARK.encode() in pathlib.Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if marked and os.path.basename(command).startswith(name):
            found.append(int(pid))
    return found


@pytest.fixture(scope="module")
def cluster():
    name, value = MARK.split("=")
    os.environ[name] = value
    # A node that does not answer counts as dead after three seconds, not after half a minute.
    health = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500, "health_check_timeout_ms": 500}
    config = {**health, "health_check_failure_threshold": 5}
    head = {"num_cpus": 0, "include_dashboard": False, "node_ip_address": "127.0.0.1", "_system_config": config}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    yield cluster
    cluster.shutdown()
    del os.environ[name]
    assert until(lambda: not processes("ray")), "a worker is left"


@pytest.fixture
def nodes(cluster):
    """Two nodes of one core each; those of the test before, if they live."""
    while len(cluster.worker_nodes) < 2:
        cluster.add_node(num_cpus=1, node_ip_address="127.0.0.1")
    return sorted(cluster.worker_nodes, key=lambda node: raylet(node))


@pytest.fixture
def start(cluster):
    """Starts a command of ``python -m wad_cosim.ray`` on the cluster; ``limit``: the longest file that it can write."""
    drivers = []

    def start(command, out, *more, limit=None):
        whole = [sys.executable, "-m", "wad_cosim.ray", *command, "--address", cluster.address, "--out", str(out), *more]
        before = (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))) if limit else None
        drivers.append(subprocess.Popen(whole, stdout=-1, stderr=-1, text=True, preexec_fn=before))
        return drivers[-1]

    yield start
    for driver in drivers:
        driver.kill()
        driver.communicate()
    # Also where the test failed: the next one counts its own.
    until(lambda: not processes("ray::Learner") + processes("ray::Collector"), 60)


def finish(driver, code=0):
    """The driver's words, when it has ended as expected."""
    said = "\n".join(driver.communicate(timeout=300))
    assert driver.returncode == code, said
    return said


def children(pid, name):
    """Processes called ``name`` below ``pid``."""
    parents = {}
    for other in processes(name):
        parent = other
        while parent > 1 and parent != pid:
            parent = int(pathlib.Path(f"/proc/{parent}/stat").read_text().rsplit(")", 1)[1].split()[1])
        parents[other] = parent
    return [other for other, parent in parents.items() if parent == pid]


def raylet(node):
    return node.all_processes["raylet"][0].process.pid


def seconds(*pids):
    """What these processes have used of the cores (s)."""
    fields = [pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in pids]
    return sum(int(field[11]) + int(field[12]) for field in fields) / os.sysconf("SC_CLK_TCK")


def listeners(pids):
    """Addresses on which these processes listen, as /proc/net has them."""
    sockets = set()
    for pid in pids:
        # A process may end meanwhile.
        with contextlib.suppress(OSError):
            for file in os.listdir(f"/proc/{pid}/fd"):
                with contextlib.suppress(OSError):
                    sockets.add(os.readlink(f"/proc/{pid}/fd/{file}"))
    found = set()
    for table in ("tcp", "tcp6"):
        for line in pathlib.Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if state == "0A" and f"socket:[{rest[5]}]" in sockets:
                found.add(local.split(":")[0])
    return found
