"""What the tests share: a small scan, and runs of the command."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

LUMISCAN = os.environ.get("LUMISCAN", "lumiscan")
RECORDING = Path(__file__).resolve().parents[3] / "recordings/data/tiny.lrec"
# The same bytes on every run.
ROUNDS = ["--rounds", "1"]


class Case(unittest.TestCase):
    """A test with a folder, in which `scans` lie."""

    @classmethod
    def setUpClass(cls) -> None:
        cls.shared = Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, cls.shared, ignore_errors=True)
        coarse = ["fusion.voxel_size_m=0.05", "estimator.bands=2", "estimator.refine_poses=off"]
        settings = [part for setting in coarse for part in ("--set", setting)]
        command = [LUMISCAN, "replay", str(RECORDING), "--device", str(cls.shared), "--no-estimate", *settings]
        subprocess.run(command, check=True, capture_output=True)
        cls.scan = next(cls.shared.glob("scans/*/scan.lscan"))

    def setUp(self) -> None:
        self.folder = Path(tempfile.mkdtemp(dir=self.shared))
        self.out = self.folder / "out"

    def scans(self, count: int) -> Path:
        """A folder with that many scans."""
        folder = self.folder / "scans"
        for i in range(count):
            (folder / f"box/{i:03}").mkdir(parents=True)
            shutil.copy(self.scan, folder / f"box/{i:03}/scan.lscan")
        return folder

    def command(self, *arguments: object) -> list[str]:
        return [sys.executable, "-m", "lumiscan_studio", *map(str, arguments), "--lumiscan", LUMISCAN]

    def run_studio(self, *arguments: object) -> subprocess.CompletedProcess:
        return subprocess.run(self.command(*arguments), capture_output=True, text=True, timeout=500)

    def results(self) -> dict[str, tuple[int, int]]:
        """Which file each result is that is complete, with its pictures: one that is written again is another."""
        found = {path.parent.name: path.with_name("result.lres").stat() for path in self.out.rglob("viewer.html")}
        return {name: (stat.st_ino, stat.st_mtime_ns) for name, stat in found.items()}

    def assert_serial(self) -> None:
        """The results are those of one process without an engine, byte for byte, and nothing else is left."""
        alone = self.folder / "alone.lres"
        limits = ["--quality", "standard", "--budget", "3600", "--threads", "2"]
        command = [LUMISCAN, "estimate", str(self.scan), "-o", str(alone), *ROUNDS, *limits]
        subprocess.run(command, check=True, capture_output=True)
        for path in self.out.rglob("result.lres"):
            self.assertEqual(path.read_bytes(), alone.read_bytes(), path)
        left = [path.name for path in self.out.rglob("*") if path.suffix in (".part", ".lock")]
        self.assertEqual(left, [])
