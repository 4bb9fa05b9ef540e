"""Prints how well frames that no estimation step used are predicted, as a Markdown table.

    python3 .readme/validation.py NAME=RECORDING...

Every recording is replayed twice, as it is and without exposure and pose correction. Figures are means over the
validation frames, PSNR in dB: lit colours / albedo × light + gloss.
"""

import json
import pathlib
import subprocess
import sys
import tempfile

LUMISCAN = ["cargo", "run", "--release", "--quiet", "--locked", "-p", "capture", "--bin", "lumiscan", "--"]
UNCORRECTED = ["--set", "estimator.exposure=none", "--set", "estimator.refine_poses=off"]


def output(*arguments):
    return subprocess.run([*LUMISCAN, *arguments], check=True, stdout=subprocess.PIPE, text=True).stdout


def predicted(recording, *settings):
    with tempfile.TemporaryDirectory() as device:
        folder = output("replay", recording, "--device", device, "--rounds", "2", *settings).splitlines()[-1]
        found = json.loads(output("inspect", str(pathlib.Path(folder) / "result.lres"), "--json"))
    frames = found["witnesses"]
    return " / ".join(f"{sum(f[key] for f in frames) / len(frames):.1f}" for key in ["lit_psnr_db", "model_psnr_db"])


def main():
    print("| recording | predicted, dB | without exposure and pose correction, dB |\n|---|---|---|")
    for scene in sys.argv[1:]:
        name, recording = scene.split("=", 1)
        print(f"| {name} | {predicted(recording)} | {predicted(recording, *UNCORRECTED)} |", flush=True)


main()
