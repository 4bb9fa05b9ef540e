#!/bin/sh
# `lumiscan estimate` on a machine that has other things to do.
#
#   tests/load.sh SCAN BUDGET RESULT [LOAD] [OPTION…]
#
# LOAD is one of
#   even:SHARE       stopped and continued every second, so that it gets this share of the time (default: even:0.25)
#   stretches:SHARE  the same in random stretches: stopped for up to 5 s at a time
#   busy             two programs that compute start and end beside it at random
# OPTIONs go to `lumiscan estimate`. Prints the seconds until the result stood at its place, until the process ended, the exit
# code, and what the result says was cut. Ends with 0 if the result came within the budget and can be read.
set -eu
[ $# -ge 3 ] || { echo "usage: $0 SCAN BUDGET RESULT [even:SHARE|stretches:SHARE|busy] [OPTION…]" >&2; exit 2; }
scan=$1 budget=$2 result=$3 load=${4:-even:0.25}
shift 3
[ $# -eq 0 ] || shift
lumiscan=${LUMISCAN:-target/release/lumiscan}
share=${load#*:}

# Seconds to run and to stop, one pair a line; LUMISCAN_SEED makes other ones.
pairs() {
    awk -v load="${load%:*}" -v share="$share" -v seed="${LUMISCAN_SEED:-1}" 'BEGIN {
        srand(seed)
        for (i = 0; i < 10000; i++) {
            stopped = load == "even" ? 1 - share : 0.5 + 4.5 * rand()
            print stopped * share / (1 - share), stopped
        }
    }'
}

# A program that computes, for random times; ends with the estimate.
busy() {
    awk -v seed="$1" 'BEGIN { srand(seed); for (i = 0; i < 10000; i++) print 0.2 + 3 * rand(), 2 * rand() }' |
        while read -r on off && kill -0 "$child" 2>/dev/null; do
            timeout "$on" sh -c 'while :; do :; done' || true
            sleep "$off"
        done
}

rm -f "$result"
start=$(date +%s.%N)
"$lumiscan" estimate "$scan" -o "$result" --budget "$budget" "$@" &
child=$!
case $load in
busy)
    busy 1 &
    busy 2 &
    ;;
even:* | stretches:*)
    pairs | while read -r on off; do
        sleep "$on"
        kill -STOP $child 2>/dev/null || break
        sleep "$off"
        kill -CONT $child 2>/dev/null || break
    done &
    ;;
*)
    echo "$0: no load $load" >&2
    kill $child
    exit 2
    ;;
esac
code=0
wait $child || code=$?
ended=$(date +%s.%N)
# A rename changes the time of the status, not that of the content.
seconds=$(awk "BEGIN { printf \"%.2f\", $(stat -c %.Z "$result") - $start }")
echo "result after $seconds s of $budget s, process after $(awk "BEGIN { printf \"%.2f\", $ended - $start }") s, exit code $code"
"$lumiscan" inspect "$result" | sed -n '/^cuts/,/^warnings/p'
awk "BEGIN { exit !($seconds <= $budget) }"
