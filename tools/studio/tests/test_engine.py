"""Scans through HyperQueue, undisturbed and with everything killed once."""

from __future__ import annotations

import csv
import json
import shutil
import signal
import subprocess
import unittest
from pathlib import Path

from .cluster import CLIENT, Cluster, until
from .support import LUMISCAN, ROUNDS, Case


class Undisturbed(Case):
    def test_a_bad_scan_fails_once_and_the_others_are_done(self) -> None:
        scans = self.scans(3)
        bad = scans / "box/001/scan.lscan"
        bad.write_bytes(bad.read_bytes()[:-100])
        run = self.run_studio("estimate", scans, "--out", self.out, *ROUNDS)
        self.assertEqual(run.returncode, 1, run.stderr)
        self.assertIn("box/001: ", run.stderr)
        self.assertIn("2 done, 1 failed", run.stdout)
        with (self.out / "summary.csv").open() as file:
            rows = {row["scan"]: row for row in csv.DictReader(file)}
        self.assertEqual([rows[name]["outcome"] for name in sorted(rows)], ["done", "failed", "done"])
        self.assertEqual(rows["box/001"]["retry"], "never")
        self.assertIn("cut off", rows["box/001"]["problem"])
        self.assertGreater(float(rows["box/000"]["cpu_seconds"]), 0)
        self.assertIn("box/001", (self.out / "summary.html").read_text())
        self.assert_serial()

        # Once more: what is there stays, and its costs are still known.
        before = self.results()
        run = self.run_studio("estimate", scans, "--out", self.out, *ROUNDS)
        self.assertIn("1 failed, 2 unchanged", run.stdout)
        self.assertEqual(self.results(), before)
        with (self.out / "summary.csv").open() as file:
            self.assertEqual(next(csv.DictReader(file))["cpu_seconds"], rows["box/000"]["cpu_seconds"])

        run = self.run_studio("compare", self.out, self.out, "--out", self.folder / "compared")
        self.assertIn("0 of 2 changed", run.stdout)

    def test_other_settings_are_compared(self) -> None:
        scans = self.scans(1)
        for out, effort in [(self.out, ROUNDS), (self.folder / "other", ["--rounds", "2"])]:
            self.assertEqual(self.run_studio("estimate", scans, "--out", out, *effort).returncode, 0)
        run = self.run_studio("compare", self.out, self.folder / "other", "--out", self.folder / "compared")
        self.assertIn("1 of 1 changed", run.stdout)
        page = (self.folder / "compared/compare.html").read_text()
        self.assertEqual(page.count("<img"), 2)

    def test_too_little_memory_is_another_failure_than_a_bad_scan(self) -> None:
        run = self.run_studio("estimate", self.scans(1), "--out", self.out, "--memory", "20", *ROUNDS)
        self.assertEqual(run.returncode, 1)
        line = json.loads((self.out / "box/000/outcome.json").read_text())
        self.assertEqual((line["exit_code"], line["retry"]), (6, "elsewhere"), line)

    def test_a_full_disk_leaves_nothing_half_written(self) -> None:
        # A file cannot grow beyond 20 kB, as on a disk that is full.
        scans = self.scans(1)
        command = " ".join(self.command("estimate", scans, "--out", self.out, *ROUNDS))
        shell = f"trap '' XFSZ; ulimit -f 20; exec {LUMISCAN} --json estimate {scans}/box/000/scan.lscan -o {self.folder}/r.lres"
        full = subprocess.run(["bash", "-c", f"{shell} --if-changed {' '.join(ROUNDS)}"], capture_output=True, text=True)
        self.assertEqual(full.returncode, 1, full.stderr)
        line = json.loads(full.stdout)
        self.assertEqual((line["outcome"], line["retry"]), ("failed", "repaired"))
        self.assertEqual([path.name for path in self.folder.glob("r.lres*")], [])
        self.assertEqual(subprocess.run(["bash", "-c", command], capture_output=True).returncode, 0)
        self.assert_serial()


class Killed(Case):
    def test_nothing_is_lost_and_nothing_is_done_twice(self) -> None:
        scans = self.scans(24)
        cluster = Cluster(self.folder)
        self.addCleanup(cluster.close)
        studio = self.command("estimate", scans, "--server", cluster.server_dir, "--out", self.out, *ROUNDS)
        studio = [studio[0], "-c", CLIENT, *studio[3:]]

        server, workers = cluster.server(), [cluster.worker(), cluster.worker()]
        client = cluster.start(studio)
        until("the first results", lambda: len(self.results()) >= 3)
        workers[0].kill()
        after_worker = self.results()

        until("more results", lambda: len(self.results()) >= len(after_worker) + 3)
        client.kill()
        client.wait()
        after_client = self.results()
        until("results without a client", lambda: len(self.results()) >= len(after_client) + 2)

        server.kill()
        server.wait()
        workers[1].kill()
        until("the end of what ran", lambda: not list(self.out.rglob("*.lock")))
        after_server = self.results()
        self.assertLess(len(after_server), 24, "the server was killed too late")
        gone = subprocess.run(studio, capture_output=True, text=True, timeout=100)
        self.assertEqual(gone.returncode, 1)
        self.assertIn("repeat this command", gone.stderr)

        cluster.server(), cluster.worker(), cluster.worker()
        run = subprocess.run(studio, capture_output=True, text=True, timeout=300)
        self.assertEqual(run.returncode, 0, run.stderr)
        final = self.results()
        self.assertEqual(len(final), 24)
        for stage in (after_worker, after_client, after_server):
            self.assertEqual({name: final[name] for name in stage}, stage, "a result was made twice")
        done = [json.loads(path.read_text())["outcome"] for path in self.out.rglob("outcome.json")]
        self.assertEqual(done.count("unchanged"), len(after_server))
        self.assertEqual(done.count("done"), 24 - len(after_server))
        self.assert_serial()

    def test_two_processes_on_one_scan_do_it_once(self) -> None:
        command = [LUMISCAN, "--json", "estimate", self.scan, "--if-changed", "-o", self.folder / "r.lres", *ROUNDS]
        both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) for _ in range(2)]
        outcomes = sorted(json.loads(p.communicate()[0])["outcome"] for p in both)
        self.assertEqual(outcomes, ["done", "unchanged"])
        self.assertEqual([path.name for path in self.folder.iterdir()], ["r.lres"])

    def test_the_estimator_ends_with_its_process(self) -> None:
        command = [LUMISCAN, "--json", "estimate", self.scan, "--if-changed", "-o", self.folder / "r.lres", "--rounds", "1000000"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        until("the child", lambda: children.read_text().strip())
        child = int(children.read_text())
        process.send_signal(signal.SIGKILL)
        process.wait()
        until("the child's end", lambda: not _runs(child))


@unittest.skipUnless(shutil.which("hq"), "the program hq is not installed")
class WithWorkersThatKnowTheirMemory(Case):
    def test_a_scan_waits_for_a_worker_with_enough_memory(self) -> None:
        cluster = Cluster(self.folder)
        self.addCleanup(cluster.close)
        hq = ["hq", "--server-dir", str(cluster.server_dir)]
        journal = self.folder / "journal"
        server = cluster.start([*hq, "server", "start", "--journal", str(journal)])
        until("the server", lambda: (cluster.server_dir / "hq-current").exists())
        small, large = ([*hq, "worker", "start", "--cpus=1", f"--resource=mem=sum({mb})"] for mb in (500, 4000))
        cluster.start(small)
        command = self.command("estimate", self.scans(2), "--out", self.out, "--server", cluster.server_dir, "--memory", "2000", *ROUNDS)
        client = cluster.start(command)
        until("the job", lambda: (self.out / ".job.json").exists())
        subprocess.run([*hq, "journal", "flush"], check=True, capture_output=True)
        # The server is killed, too: with a journal it goes on with the same job.
        server.kill()
        server.wait()
        self.assertEqual(client.wait(timeout=60), 1)
        cluster.start([*hq, "server", "start", "--journal", str(journal)])
        until("the server", lambda: subprocess.run([*hq, "server", "info"], capture_output=True).returncode == 0)
        cluster.start(small)
        client = cluster.start(command)
        with self.assertRaises(subprocess.TimeoutExpired):
            client.wait(timeout=5)
        self.assertEqual(self.results(), {})
        cluster.start(large)
        self.assertEqual(client.wait(timeout=120), 0)
        self.assertEqual(len(self.results()), 2)
        jobs = json.loads(subprocess.run([*hq, "--output-mode=json", "job", "list", "--all"], capture_output=True).stdout)
        self.assertEqual(len(jobs), 1, "the second client waited for the job of the first")


def _runs(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().split(")")[1].split()[0] != "Z"
    except OSError:
        return False
