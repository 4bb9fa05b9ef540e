"""HyperQueue servers and workers as processes of their own, so that tests can kill them one by one.

The Python package starts workers only in the process of their server. `worker` starts an idle server of its own and points it at the
other one before it adds a worker; the program `hq` would do the same in one command, where it is installed.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

SERVER = """
import sys, time
from hyperqueue import LocalCluster
cluster = LocalCluster(sys.argv[1])
print("up", flush=True)
time.sleep(1e6)
"""

WORKER = """
import os, sys, tempfile, time
from hyperqueue import LocalCluster
from hyperqueue.cluster import WorkerConfig
own = tempfile.mkdtemp(dir=sys.argv[2])
cluster = LocalCluster(own)
link = os.path.join(own, "hq-current")
os.unlink(link)
os.symlink(os.path.realpath(os.path.join(sys.argv[1], "hq-current")), link)
cluster.start_worker(WorkerConfig(cores=1))
print("up", flush=True)
time.sleep(1e6)
"""


# These workers know of cores alone: nothing else can be requested of them.
CLIENT = """
import sys
from hyperqueue.ffi.protocol import ResourceRequest
from lumiscan_studio import cli, engine
engine.remote_request = lambda task: ResourceRequest(cpus=task.threads)
sys.exit(cli.main())
"""


class Cluster:
    """Processes that end with the test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.server_dir = folder / "server"
        self.processes: list[subprocess.Popen] = []

    def server(self) -> subprocess.Popen:
        self.server_dir.mkdir(exist_ok=True)
        return self._python(SERVER, str(self.server_dir))

    def worker(self) -> subprocess.Popen:
        return self._python(WORKER, str(self.server_dir), str(self.folder))

    def _python(self, code: str, *arguments: str) -> subprocess.Popen:
        process = self.start([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, text=True)
        # The package prints a table first.
        assert process.stdout is not None and "up\n" in iter(process.stdout.readline, "")
        return process

    def start(self, command: list[str], **options) -> subprocess.Popen:
        with (self.folder / "processes.log").open("a") as log:
            process = subprocess.Popen(command, stderr=log, **{"stdout": log, **options})
        self.processes.append(process)
        return process

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
            if process.stdout:
                process.stdout.close()


def until(what: str, condition, seconds: float = 120.0) -> None:
    """Waits for a condition."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"{what} did not come"
        time.sleep(0.02)
