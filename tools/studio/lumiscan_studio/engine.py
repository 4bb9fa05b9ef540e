"""HyperQueue: gets the tasks, and does all scheduling, retrying and moving between machines."""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, Iterator, Optional, Sequence

from hyperqueue import Client, Job, LocalCluster
from hyperqueue.cluster import WorkerConfig
from hyperqueue.ffi.protocol import ResourceRequest

from .problem import Problem
from .task import Task

# Called with the numbers of finished and failed tasks, about once a second.
Progress = Callable[[int, int], None]
Request = Callable[[Task], ResourceRequest]


@contextmanager
def local() -> Iterator[tuple[Path, Request]]:
    """A server and a worker in this process, which end with it."""
    cores = len(os.sched_getaffinity(0))
    total_mb = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e6

    def request(task: Task) -> ResourceRequest:
        # Such a worker knows of cores alone: memory is requested as the cores that it is the share of.
        needed = max(task.threads, math.ceil(task.memory_mb / (total_mb / cores)))
        if task.threads > cores:
            raise Problem(f"--threads {task.threads}: this machine has {cores} cores")
        if needed > cores:
            raise Problem(f"{task.scan.path} needs {task.memory_mb} MB, this machine has {total_mb:.0f}; use --server")
        return ResourceRequest(cpus=needed)

    cluster = _quiet(LocalCluster)
    try:
        cluster.start_worker(WorkerConfig(cores=cores))
        yield Path(cluster.cluster.server_dir), request
    finally:
        cluster.stop()


def _quiet(start: Callable[[], LocalCluster]) -> LocalCluster:
    """Starts a server, whose table of ports and versions goes to stderr: stdout is for results."""
    sys.stdout.flush()
    stdout = os.dup(1)
    os.dup2(2, 1)
    try:
        return start()
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)


@contextmanager
def remote(server: Path) -> Iterator[tuple[Path, Request]]:
    """A running server, whose workers share this machine's file system."""
    if not (server / "hq-current").exists():
        raise Problem(f"{server} is no folder of a HyperQueue server; start one with: hq server start --server-dir {server}")
    yield server, remote_request


def remote_request(task: Task) -> ResourceRequest:
    """Cores, and memory as the workers of `hq worker start` report it."""
    return ResourceRequest(cpus=task.threads, resources={"mem": task.memory_mb})


def run(server: Path, tasks: Sequence[Task], request: Request, note: Path, progress: Progress) -> dict[int, str]:
    """Runs the tasks; returns the errors of those that failed, by their place. A job that an earlier client left is waited for."""
    client = _reaching(server, lambda: Client(server))
    identity = {"server": _uid(server), "tasks": _digest(tasks)}
    number = _noted(note, identity)
    if number is None or not _wait(client, server, number, progress):
        job = _job(tasks, request)
        number = _reaching(server, lambda: client.submit(job)).id
        note.write_text(json.dumps({**identity, "job": number}))
        _wait(client, server, number, progress)
    failed = _reaching(server, lambda: client.connection.get_failed_tasks([number]))
    note.unlink()
    return {place: context.error for place, context in failed.get(number, {}).items()}


def _job(tasks: Sequence[Task], request: Request) -> Job:
    job = Job(max_fails=None, name="lumiscan-studio")
    for task in tasks:
        task.folder.mkdir(parents=True, exist_ok=True)
        job.program(
            list(task.command),
            name=task.scan.name,
            stdout=str(task.outcome),
            stderr=str(task.log),
            resources=request(task),
        )
    return job


def _wait(client: Client, server: Path, number: int, progress: Progress) -> bool:
    """Waits for a job; False if the server does not know it."""
    known = False

    def report(jobs: dict) -> None:
        nonlocal known
        for state in jobs.values():
            known = True
            progress(state["finished"], state["failed"])

    _reaching(server, lambda: client.connection.wait_for_jobs([number], report))
    return known


def _reaching(server: Path, ask: Callable):
    """What the server answers."""
    try:
        return ask()
    except Exception as e:
        # The rest is a backtrace of the library.
        reason = " ".join(str(e).split("Stack backtrace")[0].split())
        raise Problem(
            f"{server}: {reason}; see that the server runs and is of the version of this package, then repeat this command: what is done "
            "stays done",
            code=1,
        ) from e


def _uid(server: Path) -> str:
    try:
        return json.loads((server / "hq-current" / "access.json").read_text())["server_uid"]
    except (OSError, ValueError, KeyError) as e:
        raise Problem(f"{server}: its access record cannot be read ({e}); is it a server's folder?") from e


def _digest(tasks: Sequence[Task]) -> str:
    return hashlib.sha256(json.dumps([task.command for task in tasks]).encode()).hexdigest()


def _noted(note: Path, identity: dict[str, str]) -> Optional[int]:
    """The job that an earlier client submitted to this server for these tasks."""
    try:
        noted = json.loads(note.read_text())
    except (OSError, ValueError):
        return None
    return noted.get("job") if all(noted.get(key) == value for key, value in identity.items()) else None
