#!/usr/bin/env bash
# The executable and the tests for aarch64, cross-built and run under qemu-user. Scans, results and trajectories have to be the
# same bytes as those of this machine's build.
#
#   tests/arm64.sh [--smoke]
#
# Looks for fused operations in the executable, replays `tiny.lrec` and `tabletop.lrec` on both architectures, then runs the
# unit tests of every crate and the end-to-end tests of commands, bad input and replay. `--smoke` ends after `tiny.lrec`. Says
# what is missing and ends with 0 where it cannot run; on Debian: apt-get install gcc-aarch64-linux-gnu libc6-dev-arm64-cross
# qemu-user-static, and the Rust target aarch64-unknown-linux-gnu. LUMISCAN names this machine's executable (default:
# target/debug/lumiscan, which is built).
set -euo pipefail
cd "$(dirname "$0")/.."
case "${1:-}" in
'') recordings="tiny tabletop" ;;
--smoke) recordings=tiny ;;
*) sed -n '5s/^# *//p' "$0" >&2; exit 2 ;;
esac
skip() { echo "skipped: $*"; exit 0; }
target=aarch64-unknown-linux-gnu
for tool in aarch64-linux-gnu-gcc qemu-aarch64-static; do command -v $tool >/dev/null || skip "$tool is not installed"; done
[ -d "$(rustc --print sysroot)/lib/rustlib/$target" ] || skip "the Rust target $target is not installed"

# Loader and libraries of one installation: the cross compiler's, where there are none of the architecture itself. Mixed, programs
# hang as soon as they start a thread.
root=/
[ -e /lib/ld-linux-aarch64.so.1 ] || root=/usr/aarch64-linux-gnu
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64-static -L $root"
# The same bytes as with link-time optimisation, sooner.
export CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16
if [ -z "${LUMISCAN:-}" ]; then
    cargo build --locked -p capture --bin lumiscan
    LUMISCAN=target/debug/lumiscan
fi
cargo build --release --locked -p capture --bin lumiscan --target $target

arm=target/$target/release/lumiscan
emulated() { qemu-aarch64-static -L "$root" "$@"; }

# Fused and approximate operations give other bits than x86-64. The cube root's are fused there, too; tiny-skia draws pictures.
fused=$(aarch64-linux-gnu-objdump -dC --no-show-raw-insn "$arm" |
    awk '/>:$/ { f = $0 } $2 ~ /^(fn?m(la|ls|add|sub)|frecp|frsqrt)/ && f !~ /<(libm::math::cbrt|tiny_skia)::/ { print f; print }')
[ -z "$fused" ] || { echo "fused or approximate operations:"; echo "$fused"; exit 1; }
echo "no fused or approximate operation decides a result"

work=$(mktemp -d "$PWD/target/arm64.XXXXXX")
trap 'rm -rf "$work"' EXIT
echo "$("$LUMISCAN" --version) beside $(emulated $arm --version)"
for recording in $recordings; do
    for side in host arm; do
        run=("$LUMISCAN")
        [ $side = host ] || run=(emulated "$arm")
        began=$SECONDS
        folder=$("${run[@]}" replay "recordings/data/$recording.lrec" --device "$work/$recording.$side" --no-estimate | tail -1)
        "${run[@]}" estimate "$folder/scan.lscan" -o "$folder/result.lres" --rounds 2
        echo "$recording, $side: $((SECONDS - began)) s"
        ln -s "$folder" "$work/$recording.$side.scan"
    done
    for file in scan.lscan result.lres trajectory.txt; do
        cmp "$work/$recording.host.scan/$file" "$work/$recording.arm.scan/$file"
        echo "$recording: $file is the same, $(stat -Lc %s "$work/$recording.arm.scan/$file") bytes"
    done
done
[ "${1:-}" != --smoke ] || exit 0

for crate in recordings firmware-config isa fusion estimator; do cargo test --release --locked --target $target -p $crate --lib; done
cargo test --release --locked --target $target -p capture --bins

# These tests start the executable, and that starts itself: the kernel has to know qemu-user as the interpreter of aarch64.
export QEMU_LD_PREFIX=$root
if "$arm" --version >/dev/null 2>&1; then
    cargo test --release --locked --target $target -p capture --test commands --test bad_input --test replay
else
    echo "skipped: tests that start the executable. As root, where a container does not have it from its host:"
    echo "    mount -t binfmt_misc binfmt_misc /proc/sys/fs/binfmt_misc"
    echo "    cat /usr/lib/binfmt.d/qemu-aarch64.conf >/proc/sys/fs/binfmt_misc/register"
fi
