"""The command `lumiscan-studio`."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Optional, Sequence

from . import compare, engine, outcomes, scans, summary, task
from .problem import Problem
from .progress import Progress

EXIT = """exit codes: 0 every scan has its result; 1 some have none, or the server is gone: the same command goes on where it ended;
2 usage"""


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Runs the command; returns its exit code."""
    args = _parser().parse_args(arguments)
    try:
        return args.run(args)
    except Problem as problem:
        print(f"error: {problem}", file=sys.stderr)
        return problem.code
    except KeyboardInterrupt:
        print("stopped; the same command goes on where it ended", file=sys.stderr)
        return 130


def _estimate(args: argparse.Namespace) -> int:
    out = args.out.resolve()
    effort = task.Effort(args.lumiscan, args.quality, args.budget, args.rounds, args.threads, args.memory)
    tasks = [task.of(scan, out, effort) for scan in scans.find(args.scans)]
    out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        place = engine.remote(args.server.resolve()) if args.server else engine.local()
        server, request = stack.enter_context(place)
        errors = engine.run(server, tasks, request, out / ".job.json", Progress(len(tasks)))
    ended = [outcomes.read(t.scan.name, t.folder, errors.get(place)) for place, t in enumerate(tasks)]
    summary.write(out, ended)
    for outcome in ended:
        if outcome.problem:
            print(f"{outcome.name}: {outcome.problem}", file=sys.stderr)
    print(f"{summary.counted(ended)}; {out / 'summary.html'}")
    return 0 if all(o.has_result for o in ended) else 1


def _compare(args: argparse.Namespace) -> int:
    changes = compare.compare(args.a, args.b, args.lumiscan)
    args.out.mkdir(parents=True, exist_ok=True)
    compare.write(args.out.resolve(), args.a.resolve(), args.b.resolve(), changes)
    print(f"{sum(c.kind != 'identical' for c in changes)} of {len(changes)} changed; {args.out.resolve() / 'compare.html'}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="lumiscan-studio", description=__doc__, epilog=EXIT)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    estimate = commands.add_parser("estimate", help="estimate many scans", epilog=EXIT)
    estimate.set_defaults(run=_estimate)
    estimate.add_argument("scans", nargs="+", type=Path, metavar="SCAN", help="scan files, or folders that hold some at any depth")
    estimate.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the results")
    estimate.add_argument("--quality", choices=["draft", "standard", "best"], default="standard")
    estimate.add_argument("--budget", type=_positive, default=3600.0, metavar="S", help="seconds for one scan [3600]")
    estimate.add_argument("--rounds", type=_count, metavar="N", help="fixed number of ray rounds instead of the budget")
    estimate.add_argument("--threads", type=_count, default=1, metavar="N", help="threads for one scan [1: most scans an hour]")
    estimate.add_argument("--memory", type=_count, metavar="MB", help="address space for one scan [from the size of its file]")
    estimate.add_argument("--server", type=Path, metavar="DIR", help="folder of a HyperQueue server [starts one and a worker here]")
    _lumiscan(estimate)

    comparison = commands.add_parser("compare", help="compare two sets of results of the same scans")
    comparison.set_defaults(run=_compare)
    comparison.add_argument("a", type=Path, metavar="A", help="output folder of `estimate`")
    comparison.add_argument("b", type=Path, metavar="B", help="another one")
    comparison.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the comparison")
    _lumiscan(comparison)
    return parser


def _lumiscan(parser: argparse.ArgumentParser) -> None:
    default = os.environ.get("LUMISCAN", "lumiscan")
    parser.add_argument("--lumiscan", type=_executable, default=default, metavar="FILE", help="the executable [LUMISCAN, or in PATH]")


def _executable(text: str) -> Path:
    found = shutil.which(text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text} is not an executable")
    return Path(found).resolve()


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError("more than 0 and below 1000000")
    return value


def _count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 1_000_000_000:
        raise argparse.ArgumentTypeError("a whole number above 0")
    return value
