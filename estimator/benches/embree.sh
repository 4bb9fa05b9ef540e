#!/usr/bin/env bash
# Rays a second, Embree's and ours, one core each, over the same meshes and rays in alternating runs; medians and their
# ratio. Needs Embree's headers (Debian: libembree-dev); the scene of posed pictures needs LUMISCAN_SHARED.
#
#     estimator/benches/embree.sh [RUNS]
set -euo pipefail
cd "$(dirname "$0")/../.."
runs="${1:-5}"
folder="$PWD/target/embree"
mkdir -p "$folder"
header() { echo "#include <$1/rtcore.h>" | cc -E - >/dev/null 2>&1; }
if header embree4; then library=embree4; elif header embree3; then library=embree3; else
    echo "skipped: Embree is not installed (Debian: apt-get install libembree-dev)"
    exit 0
fi
cc -O3 -march=native -o "$folder/embree" estimator/benches/embree.c "-l$library" -lm
bench() { cargo bench --quiet --workspace --bench rays -- "$folder" | grep -v '^skipped'; }
bench >/dev/null
rm -f "$folder"/*.theirs "$folder"/*.ours
for _ in $(seq "$runs"); do
    bench | while read -r scene rates; do echo "$rates" >>"$folder/$scene.ours"; done
    for rays in "$folder"/*.rays; do "$folder/embree" "$rays" >>"${rays%.rays}.theirs"; done
done
median() { cut -d' ' -f"$2" "$1" | sort -g | sed -n "$(((runs + 1) / 2))p"; }
printf '%-8s%-9s%10s%10s%16s   (million rays a second, medians of %s runs)\n' scene rays Embree ours 'Embree / ours' "$runs"
for ours in "$folder"/*.ours; do
    scene="$(basename "${ours%.ours}")"
    for kind in 1:any 2:closest; do
        a="$(median "${ours%.ours}.theirs" "${kind%:*}")"
        b="$(median "$ours" "${kind%:*}")"
        awk -v s="$scene" -v k="${kind#*:}" -v a="$a" -v b="$b" \
            'BEGIN { printf "%-8s%-9s%10.2f%10.2f%16.2f\n", s, k, a, b, a / b }'
    done
    echo "         blocked: $(median "${ours%.ours}.theirs" 3) / $(median "$ours" 3)"
done
