#!/usr/bin/env bash
# The executable on a real Linux USB stack with one slow core: user-mode Linux with a simulated Kinect 1414, which is the
# folder `kinect-usb` of the shared data.
#
#   LUMISCAN_SHARED=FOLDER tests/uml.sh [--figures]
#
# Every pixel of the pattern, losses, slow replies, unplugging, SIGKILL, the kernel's own driver, capture without and with
# fusion. `--figures` prints the costs beside libfreenect's instead (capture/README.md). Where the machine cannot run it,
# says why and ends with 0.
set -euo pipefail
cd "$(dirname "$0")/.."
lumiscan=$(realpath "${LUMISCAN:-target/debug/lumiscan}")
pattern=$(realpath "${USB_PATTERN:-target/debug/examples/usb_pattern}")
skip() { echo "skipped: $*"; exit 0; }
[ -d "${LUMISCAN_SHARED:-}/kinect-usb" ] || skip "LUMISCAN_SHARED has no folder kinect-usb"
[ "$(uname -m)" = x86_64 ] || skip "user-mode Linux is built for x86-64"
[ "$(id -u)" = 0 ] || skip "only root gives the virtual machine a processor of its own"
for tool in gcc make busybox; do command -v $tool >/dev/null || skip "$tool is not installed"; done
pkg-config --exists libfreenect || skip "libfreenect-dev is not installed"

rig=$PWD/target/kinect-usb
mkdir -p "$rig"
cp -ru "$LUMISCAN_SHARED/kinect-usb/." "$rig"
chmod -R u+w "$rig"
make -s -C "$rig"
work=$(mktemp -d "$PWD/target/uml.XXXXXX")
trap 'rm -rf "$work"' EXIT
# /run has half of it, and a recording without a length wants a gigabyte.
export MEM=2800M

# Runs a script in the virtual machine. One processor, which goes before what else runs here: the machine is slow as it is.
last=$(($(nproc) - 1))
priority=
chrt -r 1 true 2>/dev/null && priority="chrt -r 1"
guest() { timeout 120 taskset -c $last $priority "$rig/run_uml.sh" "R=/run; L=$lumiscan; W=$work; $*" >"$work/log" 2>&1; }
guest "true" || skip "user-mode Linux does not start here: $(tail -1 "$work/log")"

fail() { echo "failed: $*"; sed 's/^/    /' "$work/log" | tail -40; exit 1; }
# A busy host halts the machine for longer than a queue can hold: three tries.
check() {
    local name=$1
    for _ in 1 2 3; do
        if "$name"; then echo "ok: ${name//_/ }: $result"; return; fi
    done
    fail "${name//_/ }: $result"
}
# A number of the JSON file `$work/$1`, by its place.
number() { python3 -c 'import json,sys
v = json.load(open(sys.argv[1]))
for k in sys.argv[2].split("."): v = v[k]
print(v)' "$work/$1" "$2"; }
seen() { result=$("$pattern" "$work/$1" 2>&1); }
# True if nothing was lost on the way: `record`'s answer in `$work/$1`.
nothing_lost() {
    for counter in depth.missing color.missing depth.dropped_frames color.dropped_frames dropped_packets; do
        [ "$(number "$1" counters.$counter)" = 0 ] || { result="$counter: $(number "$1" counters.$counter)"; return 1; }
    done
}
record='rec() { n=$1; shift; "$L" --json record $R/$n.lrec "$@" >$W/$n.json 2>$W/$n.log; echo $? >$W/$n.code; cp $R/$n.lrec $W; };'

every_frame_is_recorded() {
    KSIM_NODROP=1 guest "$record" "rec frames --seconds 6" && seen frames.lrec && nothing_lost frames.json
}
every_pixel_of_every_packet_is_recorded() {
    KSIM_NODROP=1 guest "$record" "rec raw --seconds 5 --raw" && seen raw.lrec && nothing_lost raw.json
}
lost_packets_are_counted_and_nothing_else_is_wrong() {
    KSIM_NODROP=1 KSIM_DROP=97 guest "$record" "rec lossy --seconds 4 --raw" && seen lossy.lrec || return 1
    local stream missing packets
    for stream in depth color; do
        missing=$(number lossy.json counters.$stream.missing) packets=$(number lossy.json counters.$stream.packets)
        # Both streams together lose every 97th packet.
        [ "$missing" -gt $((packets / 150)) ] && [ "$missing" -lt $((packets / 65)) ] || { result="$missing of $packets"; return 1; }
        [ "$(number lossy.json counters.$stream.resyncs)" = 0 ] || { result="resyncs"; return 1; }
    done
}
replies_of_512_bytes_are_waited_out() {
    KSIM_NODROP=1 KSIM_QUIRK512=1 guest "$record" "rec quirk --seconds 2" && seen quirk.lrec && nothing_lost quirk.json
}
unplugging_leaves_a_recording() {
    KSIM_NODROP=1 guest "$record" 'rec unplug & sleep 5; kill $(pidof vhci_rig); wait' && seen unplug.lrec || return 1
    [ "$(cat "$work/unplug.code")" = 3 ] && grep -q unplugged "$work/unplug.log" || { result="exit $(cat "$work/unplug.code")"; return 1; }
}
after_a_sigkill_it_records_again() {
    KSIM_NODROP=1 guest "$record" '"$L" record $R/killed.lrec & sleep 4; kill -9 $!; wait; rec again --seconds 3' \
        && seen again.lrec && nothing_lost again.json
}
the_kernel_driver_gives_way_and_comes_back() {
    # gspca_kinect is bound as soon as the camera is plugged in.
    KSIM_NODROP=1 guest "$record" 'bound() { ls /sys/bus/usb/drivers/kinect 2>/dev/null | grep -c :; };' \
        'bound >$W/before; rec kernel --seconds 2; bound >$W/after' && seen kernel.lrec && nothing_lost kernel.json || return 1
    result="$result; bound before: $(cat "$work/before"), after: $(cat "$work/after")"
    [ "$(cat "$work/before")" = 1 ] && [ "$(cat "$work/after")" = 1 ]
}
daemon='daemon() { "$L" capture --device $R/device --auto --no-estimate --socket $R/control >$W/daemon.log 2>&1 & D=$!; sleep 5; };
status() { sleep 1.5; cp $R/device/status.json $W/$1.json; };
faults() { awk "{print \$10}" /proc/$D/stat; };'
capture_without_fusion_loses_nothing() {
    # Daemon and streams run; the pattern never rests, so no scan begins.
    KSIM_NODROP=1 guest "$daemon" 'daemon; f=$(faults); sleep 15; echo $(($(faults) - f)) >$W/faults; status waiting; kill $D; wait' || return 1
    result="$(cat "$work/faults") page faults in 15 s"
    for cause in missing_packets dropped_frames incomplete_frames lost_frames; do
        [ "$(number waiting.json drops.$cause)" = 0 ] || { result="$cause"; return 1; }
    done
    [ "$(cat "$work/faults")" -le 75 ]
}
capture_with_fusion_gives_way_by_pairs() {
    KSIM_NODROP=1 guest "$daemon" 'daemon; kill -USR1 $D; sleep 6; status scanning; kill -USR2 $D; sleep 2; kill $D; wait' || return 1
    result="$(number scanning.json drops.dropped_pairs) pairs dropped, $(number scanning.json scan.fused_pairs) fused"
    for cause in missing_packets dropped_frames incomplete_frames lost_frames; do
        [ "$(number scanning.json drops.$cause)" = 0 ] || { result="$cause"; return 1; }
    done
    # One at each end of the scan.
    [ "$(number scanning.json drops.unpaired_color)" -le 2 ] && [ "$(number scanning.json drops.unpaired_depth)" -le 2 ]
}

# Costs of $1 over 10 s, from the difference between runs of 5 and of 15 s; `%s` in it is the number of seconds.
cost() {
    local s
    for s in 5 15; do
        # shellcheck disable=SC2059
        KSIM_NODROP=1 guest "busybox time -f 'cost %U %S %R %w %c' $(printf "$2" $s)" || fail "$1"
        grep '^cost' "$work/log" >"$work/cost.$s"
    done
    paste -d' ' "$work/cost.5" "$work/cost.15" | awk -v name="$1" '{
        printf "| %s | %.1f | %.1f | %.0f |\n", name, ($8+$9-$2-$3)*1000/300, ($10-$4)/300, ($11+$12-$5-$6)/300 }'
}
if [ "${1:-}" = --figures ]; then
    echo "| program | CPU-ms | page faults | switches |"
    echo "| --- | --- | --- | --- |"
    cost "libfreenect, every pixel compared" "./fnprobe %s bayer 11"
    cost "\`lumiscan record\`" "\$L record \$R/a.lrec --seconds %s"
    cost "\`lumiscan record --raw\`" "\$L record \$R/a.lrec --seconds %s --raw"
    cost "\`lumiscan capture\`, waiting" "timeout -s TERM %s \$L capture --device \$R/d --auto --no-estimate --socket \$R/c || true"
    exit 0
fi
check every_frame_is_recorded
check every_pixel_of_every_packet_is_recorded
check lost_packets_are_counted_and_nothing_else_is_wrong
check replies_of_512_bytes_are_waited_out
check unplugging_leaves_a_recording
check after_a_sigkill_it_records_again
check the_kernel_driver_gives_way_and_comes_back
check capture_without_fusion_loses_nothing
check capture_with_fusion_gives_way_by_pairs
