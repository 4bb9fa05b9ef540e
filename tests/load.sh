#!/bin/sh
# `lumiscan estimate` under load: stopped and continued, so that it gets a quarter of its time.
#
#   tests/load.sh SCAN BUDGET RESULT
#
# Prints the seconds until the result stood on disk, the exit code, and what the result says was cut. Ends with 0 if the
# result came within the budget and can be read.
set -eu
[ $# -eq 3 ] || { echo "usage: $0 SCAN BUDGET RESULT" >&2; exit 2; }
scan=$1 budget=$2 result=$3
lumiscan=${LUMISCAN:-target/release/lumiscan}
rm -f "$result"
start=$(date +%s.%N)
"$lumiscan" estimate "$scan" -o "$result" --budget "$budget" &
child=$!
# A quarter of every second.
while kill -0 $child 2>/dev/null; do
    sleep 0.25
    kill -STOP $child 2>/dev/null || break
    sleep 0.75
    kill -CONT $child 2>/dev/null || break
done
code=0
wait $child || code=$?
seconds=$(awk "BEGIN { print $(stat -c %.Y "$result") - $start }")
echo "result after $seconds s of $budget s, exit code $code"
"$lumiscan" inspect "$result" | sed -n '/^cuts/,/^warnings/p'
awk "BEGIN { exit !($seconds <= $budget) }"
