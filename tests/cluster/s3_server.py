"""An S3 server on loopback, and proxies before it that fail."""

import socket
import subprocess
import sys
import time
from itertools import count
from pathlib import Path

from upath import UPath

from tests.cluster.ports import free_port

PROXY = Path(__file__).with_name("s3_proxy.py")


class Server:
    """moto's server; where it is and who may use it is in `environment`, not in a URL."""

    def __init__(self, folder):
        self.folder, self.port, self.numbers = folder, free_port(), count()
        self.processes = list[subprocess.Popen]()
        self.environment = {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self.port}",
            "AWS_ACCESS_KEY_ID": "nobody",
            "AWS_SECRET_ACCESS_KEY": "nothing",
            "AWS_DEFAULT_REGION": "us-east-1",
        }
        code = "from moto.server import main; main()"
        self._start("-c", code, "-H", "127.0.0.1", "-p", str(self.port), port=self.port)

    def new_bucket(self):
        """The URL of a bucket; the environment must be set."""
        place = UPath(f"s3://bucket{next(self.numbers)}/", use_listings_cache=False)
        place.fs.mkdir(place.path)
        return str(place).rstrip("/")

    def behind_proxy(self, *options):
        """The endpoint of a proxy with these options, such as "--every", "50"."""
        port = free_port()
        self._start(PROXY, str(port), f"127.0.0.1:{self.port}", *options, port=port)
        return f"http://127.0.0.1:{port}"

    def refused(self):
        """What the proxies refused: a line for each request."""
        return [
            line
            for log in self.folder.iterdir()
            for line in log.read_text().splitlines()
            if line.startswith(("503 ", "403 "))
        ]

    def _start(self, *command, port):
        with (self.folder / f"{port}.txt").open("w") as log:
            process = subprocess.Popen([sys.executable, *command], stdout=log, stderr=log)
        self.processes.append(process)
        end = time.monotonic() + 60
        while True:
            assert process.poll() is None, (self.folder / f"{port}.txt").read_text()
            assert time.monotonic() < end
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                return
            except OSError:
                time.sleep(0.05)

    def close(self):
        for process in reversed(self.processes):
            process.kill()
            process.wait()
