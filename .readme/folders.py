"""Prints the folder map of every crate as Markdown: each folder and file with the first sentence of its documentation.

    python3 folders.py
"""

import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parent.parent
CRATES = ["recordings", "firmware-config", "isa", "fusion", "estimator", "capture", "tests"]


def sentence(path):
    """First sentence of the module documentation."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("//!"):
            break
        lines.append(line[3:].strip())
    paragraph = " ".join(lines).split("  ")[0]
    text = re.split(r"(?<=[.:;]) (?=[A-Z])", paragraph)[0].rstrip(".:;")
    return re.sub(r"\[(`[^`]+`)\](?:\([^)]*\))?", r"\1", text)


def rows(folder):
    """One row for the folder, one for each of its files, and those of its folders."""
    entries = sorted(folder.iterdir())
    head = next((folder / name for name in ["mod.rs", "lib.rs", "main.rs"] if (folder / name).exists()), None)
    beside = folder.with_suffix(".rs")
    documented = head or (beside if beside.exists() else None)
    shown = folder.relative_to(ROOT)
    yield f"| **[{shown}/]({shown})** | {sentence(documented) if documented else ''} |"
    for path in entries:
        if path.suffix == ".rs" and path != head and not path.with_suffix("").is_dir() and path.stem != "tests":
            yield f"| {path.name} | {sentence(path)} |"
    for path in entries:
        if path.is_dir() and path.name != "tests" and any(path.rglob("*.rs")):
            yield from rows(path)


def main():
    for crate in CRATES:
        print(f"### {crate}\n\n| path | content |\n|---|---|")
        print("\n".join(rows(ROOT / crate / "src")) + "\n")


main()
