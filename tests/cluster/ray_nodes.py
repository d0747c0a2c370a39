"""A Ray cluster of two nodes, each a command of its own, with a token of its own."""

import os
import secrets
import subprocess
import sys
import time
from shutil import rmtree
from tempfile import mkdtemp

import psutil

from tests.cluster.ports import free_port

RAY = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block"]
SMALL = ("--num-cpus", "1", "--object-store-memory", "100000000", "--disable-usage-stats")
ANY_PORTS = ("--min-worker-port", "0", "--max-worker-port", "0")  # two nodes of one machine
STARTED, ENDED = "Ray runtime started", 60.0


class RayNodes:
    """A head, which takes Ray's clients, and nodes that join it; one processor each.

    Ray listens on every interface, so who has no token is turned away.
    """

    def __init__(self, folder):
        self.folder, self.port, client = folder, free_port(), free_port()
        self.environment = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
        self.address, self.on = f"127.0.0.1:{self.port}", f"ray://127.0.0.1:{client}"
        clients = ("--port", str(self.port), "--ray-client-server-port", str(client))
        self.nodes = list[subprocess.Popen]()
        self.files = mkdtemp(prefix="ray-")  # of a short path: Ray's sockets are there
        here = ("--include-dashboard=false", "--temp-dir", self.files)
        self.head = self._start("--head", *clients, *here)

    def add_node(self):
        return self._start("--address", self.address)

    def _start(self, *options):
        log = self.folder / f"node{len(self.nodes)}.txt"
        command = [*RAY, *options, "--node-ip-address", "127.0.0.1", *SMALL, *ANY_PORTS]
        with log.open("w") as out:
            node = subprocess.Popen(
                command,
                cwd=self.folder,
                env={**os.environ, **self.environment},
                stdout=out,
                stderr=out,
                start_new_session=True,
            )
        self.nodes.append(node)
        end = time.monotonic() + ENDED
        while STARTED not in (printed := log.read_text()):
            assert node.poll() is None, printed
            assert time.monotonic() < end, printed
            time.sleep(0.1)
        return node

    def training(self):
        """The processes that train a unit now."""
        found = []
        for node in self.nodes:
            for process in processes_of(node):
                try:
                    if process.cmdline()[:1] == ["ray::train_sent"]:
                        found.append(process)
                except psutil.Error:  # it has ended
                    pass
        return found

    def kill(self, node):
        """End all processes of a node at once, as a machine without power does."""
        for process in processes_of(node):
            process.kill()
        node.wait()

    def close(self):
        for node in reversed(self.nodes):
            self.kill(node)
        rmtree(self.files, ignore_errors=True)


def processes_of(node):
    """The processes of a node: they are its session."""
    found = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == node.pid:
                found.append(process)
        except (ProcessLookupError, psutil.Error):
            pass
    return found
