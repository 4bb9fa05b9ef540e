"""Fills the tables of the documents with the output of the commands that make them.

    python3 .readme/figures.py [NAME...]        every table, or those named

A table stands between `<!-- figures:NAME COMMAND -->` and `<!-- /figures -->`. COMMAND runs in a shell at the root of the
repository and prints Markdown. Below it stand the command, the machine and the date, unless `text` stands in the place of
`figures`. LUMISCAN_SHARED has to name the folder of shared test data. Measure tables with times on an idle machine.
"""

import datetime
import os
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
TABLE = re.compile(r"(<!-- (figures|text):(\S+) (.+?) -->\n).*?(<!-- /\2 -->)", re.DOTALL)


def machine():
    """Number of cores and model of the processor."""
    cpus = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8")
    model = re.search(r"model name\s*: (.+)", cpus)
    return f"{os.cpu_count()} × {model.group(1) if model else 'unknown processor'}"


def fill(match, wanted):
    begin, kind, name, command, end = match.groups()
    if wanted and name not in wanted:
        return match.group(0)
    print(f"{name}: {command}", file=sys.stderr)
    text = subprocess.run(["bash", "-ceo", "pipefail", command], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    origin = f"\n*`{command}`, {machine()}, {datetime.date.today().isoformat()}*\n" if kind == "figures" else ""
    return f"{begin}{text.stdout.strip()}\n{origin}{end}"


def main():
    wanted = sys.argv[1:]
    names = set()
    for path in sorted([*ROOT.glob("*.md"), *ROOT.glob("*/*.md")]):
        before = path.read_text(encoding="utf-8")
        names |= {found[2] for found in TABLE.findall(before)}
        after = TABLE.sub(lambda match: fill(match, wanted), before)
        if after != before:
            path.write_text(after, encoding="utf-8")
    unknown = set(wanted) - names
    if unknown:
        sys.exit(f"no such table: {', '.join(sorted(unknown))}; there are {', '.join(sorted(names))}")


main()
