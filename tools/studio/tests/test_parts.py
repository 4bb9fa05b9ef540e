"""Single parts, without an engine."""

from __future__ import annotations

import tempfile
import unittest
from pathlib import Path

from lumiscan_studio import page, scans, task
from lumiscan_studio.compare import Change
from lumiscan_studio.problem import Problem
from lumiscan_studio.progress import duration


class Parts(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def scan(self, name: str) -> Path:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
        return path

    def test_scans_are_named_after_their_folders(self) -> None:
        self.scan("a/scans/x/scan.lscan"), self.scan("b/scans/x/scan.lscan"), self.scan("b/ball.lscan")
        self.scan("b/scans/.staging-x/scan.lscan")
        names = [scan.name for scan in scans.find([self.folder])]
        self.assertEqual(names, ["a/scans/x", "b/ball", "b/scans/x"])
        self.assertEqual([scan.name for scan in scans.find([self.folder / "b/scans/x/scan.lscan"])], ["x"])
        # The same file twice is one scan; two files of one name are an error.
        self.assertEqual(len(scans.find([self.folder / "b/ball.lscan"] * 2)), 1)
        with self.assertRaisesRegex(Problem, "give the folder that holds both"):
            scans.find([self.folder / "a/scans", self.folder / "b/scans"])
        with self.assertRaisesRegex(Problem, "no scan file"):
            (self.folder / "empty").mkdir()
            scans.find([self.folder / "empty"])

    def test_larger_scans_get_more_memory(self) -> None:
        small, large = self.scan("small.lscan"), self.scan("large.lscan")
        large.write_bytes(bytes(10_000_000))
        effort = task.Effort(Path("lumiscan"), "best", 60, None, 2, None)
        needs = [task.of(scans.Scan("s", path), self.folder, effort).memory_mb for path in (small, large)]
        self.assertEqual(needs[1] - needs[0], 10 * task.MB_PER_SCAN_MB)
        self.assertIn(str(needs[1]), task.of(scans.Scan("s", large), self.folder, effort).command)

    def test_the_worst_change_comes_first(self) -> None:
        worst = [
            Change("gone", "only in A"),
            Change("darker", "changed", model_psnr_db=-3.0),
            Change("doubtful", "changed", model_psnr_db=0.0, new_warnings=("x",)),
            Change("other", "changed", model_psnr_db=0.0, light=0.5),
            Change("same", "identical"),
            Change("better", "changed", model_psnr_db=2.0),
        ]
        self.assertEqual(sorted(worst[::-1], key=lambda c: c.badness, reverse=True), worst)

    def test_pages_hold_text_as_text(self) -> None:
        path = self.folder / "page.html"
        page.write(path, "a < b", "", ["name"], [["<script>"], [1.5], [None]])
        text = path.read_text()
        self.assertIn("&lt;script&gt;", text)
        self.assertIn("a &lt; b", text)

    def test_durations(self) -> None:
        self.assertEqual([duration(s) for s in (5, 89, 90, 3600, 7000)], ["5 s", "89 s", "2 min", "60 min", "1 h 57 min"])
