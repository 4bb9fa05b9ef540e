#!/usr/bin/env bash
# The tests of the files with `unsafe` under valgrind: `isa/src/dispatch.rs` with every loop of fusion that goes through it, and
# `capture/src/kinect/isochronous.rs` with the executable's real libusb on an emulated usbfs.
#
#   tests/valgrind.sh
#
# An invalid access, a value that was never set, or memory that is lost for good is an error of the test that it happens in.
# Says what is missing and ends with 0 where it cannot run. Valgrind knows no AVX-512: there the loops are those of AVX2.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v valgrind >/dev/null || { echo "skipped: valgrind is not installed"; exit 0; }
[ "$(uname -m)" = x86_64 ] || { echo "skipped: valgrind is tried on x86-64 only"; exit 0; }
# Fair turns: else threads that have much to do keep the others from theirs, and the silent-sensor watchdog bites.
memcheck="valgrind --quiet --fair-sched=yes --error-exitcode=99 --leak-check=full --show-leak-kinds=definite --errors-for-leak-kinds=definite"
export CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER="$memcheck"
cargo test --locked -p isa --lib
cargo test --locked -p fusion --lib -- tsdf:: frame::
# Neither the C compiler nor what records the packets that are played.
export CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER="$memcheck --trace-children=yes --trace-children-skip=*/cc,*/gcc,*/cc1,*/as,*/collect2,*/ld --trace-children-skip-by-arg=--simulate"
cargo test --locked -p capture --test usbfs -- --test-threads 1
