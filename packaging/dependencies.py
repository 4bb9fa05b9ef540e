"""Licences and origins of what the executable links: a Debian `copyright` file and a CycloneDX SBOM.

    python3 packaging/dependencies.py TARGET COPYRIGHT SBOM

TARGET is a Rust target triple. The lists are those of Cargo.lock, so they are the same for the same commit.
"""

import json
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
LICENCE_FILES = ("LICEN[CS]E*", "COPYING*", "COPYRIGHT*", "NOTICE*", "UNLICENSE*")


def cargo(*arguments):
    """Output of a cargo command in the repository."""
    return subprocess.run(["cargo", *arguments], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def packages(target):
    """Every package that is linked into `lumiscan`, by name and version."""
    tree = cargo("tree", "--locked", "-p", "capture", "-e", "normal", "--target", target, "--prefix", "none", "-f", "{p}")
    linked = {tuple(line.split()[:2]) for line in tree.splitlines() if line}
    metadata = json.loads(cargo("metadata", "--locked", "--format-version", "1", "--filter-platform", target))
    found = [p for p in metadata["packages"] if (p["name"], "v" + p["version"]) in linked]
    return sorted(found, key=lambda p: (p["name"], p["version"]))


def licence_texts(package):
    """Names and contents of the licence files of a package and of the C sources that it carries."""
    folder = pathlib.Path(package["manifest_path"]).parent
    # libusb is in the package of its bindings.
    places = [folder, *sorted(p for p in folder.iterdir() if p.is_dir() and p.name == "libusb")]
    files = sorted({f for place in places for pattern in LICENCE_FILES for f in place.glob(pattern) if f.is_file()})
    return [(f.relative_to(folder).as_posix(), f.read_text(encoding="utf-8", errors="replace").strip()) for f in files]


def copyright_file(found):
    """The Debian `copyright` file: ours, then each dependency; a text that several share stands once."""
    ours = [p for p in found if p["source"] is None]
    lines = ["Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/", "Upstream-Name: lumiscan", "",
             "Files: *", "Copyright: the authors of Lumiscan", f"License: {ours[0]['license']}", ""]
    texts = {}
    for p in (p for p in found if p["source"]):
        authors = ", ".join(p["authors"]) or f"the authors of {p['name']}"
        lines += [f"Files: {p['name']}-{p['version']}/*", f"Copyright: {authors}", f"License: {p['license'] or 'see below'}", ""]
        for name, text in licence_texts(p):
            texts.setdefault(text, []).append(f"{p['name']}-{p['version']}/{name}")
    for text, users in texts.items():
        lines += ["=" * 80, *users, "", text, ""]
    for name in ("LICENSE-MIT", "LICENSE-APACHE"):
        lines += ["=" * 80, f"lumiscan/{name}", "", (ROOT / name).read_text(encoding="utf-8").strip(), ""]
    return "\n".join(lines)


def sbom(found):
    """A CycloneDX 1.5 document without a time of its own."""
    checksums = {}
    name = version = None
    for line in (ROOT / "Cargo.lock").read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition(" = ")
        if key == "name":
            name = value.strip('"')
        elif key == "version":
            version = value.strip('"')
        elif key == "checksum":
            checksums[name, version] = value.strip('"')
    components = []
    for p in (p for p in found if p["source"]):
        component = {"type": "library", "name": p["name"], "version": p["version"],
                     "purl": f"pkg:cargo/{p['name']}@{p['version']}", "bom-ref": f"pkg:cargo/{p['name']}@{p['version']}"}
        if p["license"]:
            component["licenses"] = [{"expression": p["license"].replace("/", " OR ")}]
        if (p["name"], p["version"]) in checksums:
            component["hashes"] = [{"alg": "SHA-256", "content": checksums[p["name"], p["version"]]}]
        components.append(component)
    ours = next(p for p in found if p["name"] == "capture")
    return {"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1,
            "metadata": {"component": {"type": "application", "name": "lumiscan", "version": ours["version"]}},
            "components": components}


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    target, copyright_path, sbom_path = sys.argv[1:]
    found = packages(target)
    bare = [p["name"] for p in found if p["source"] and not p["license"] and not licence_texts(p)]
    if bare:
        sys.exit(f"no licence is known of {', '.join(bare)}")
    pathlib.Path(copyright_path).write_text(copyright_file(found), encoding="utf-8")
    pathlib.Path(sbom_path).write_text(json.dumps(sbom(found), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
