"""The command line of a scan, and what it needs of a machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Optional

from .scans import Scan

# Address space by the size of the scan file, more than twice what was measured (docs/studio.md), and what an allocator reserves a thread.
BASE_MB = 200
MB_PER_SCAN_MB = 50
MB_PER_THREAD = 80


@dataclass(frozen=True)
class Effort:
    """How every scan is estimated."""

    lumiscan: Path
    quality: str
    budget: float
    rounds: Optional[int]
    threads: int
    # MB for every scan; None: from the size of its file.
    memory: Optional[int]


@dataclass(frozen=True)
class Task:
    """One scan, one process."""

    scan: Scan
    folder: Path
    command: tuple[str, ...]
    threads: int
    memory_mb: int

    @property
    def outcome(self) -> Path:
        return self.folder / "outcome.json"

    @property
    def log(self) -> Path:
        return self.folder / "log.jsonl"


def of(scan: Scan, out: Path, effort: Effort) -> Task:
    """The task of a scan whose result goes below `out`."""
    folder = out / scan.name
    memory = effort.memory or round(BASE_MB + MB_PER_SCAN_MB * scan.megabytes + MB_PER_THREAD * effort.threads)
    command = [str(effort.lumiscan), "--json", "estimate", str(scan.path), "--if-changed", "-o", str(folder / "result.lres")]
    command += ["--preview", str(folder / "preview.png"), "--viewer", str(folder / "viewer.html")]
    command += ["--quality", effort.quality, "--budget", f"{effort.budget:g}"]
    command += ["--rounds", str(effort.rounds)] if effort.rounds else []
    command += ["--threads", str(effort.threads), "--memory", str(memory)]
    return Task(scan, folder, tuple(command), effort.threads, memory)
