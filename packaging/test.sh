#!/usr/bin/env bash
# Installs, starts, upgrades and purges a package in a fresh Debian of debootstrap. Needs root, debootstrap and the network.
#
#   packaging/test.sh PACKAGE.deb
set -euo pipefail
[ $# -eq 1 ] || { sed -n '4s/^# *//p' "$0" >&2; exit 2; }
package=$(realpath "$1")
for tool in debootstrap dpkg-deb; do command -v $tool >/dev/null || { echo "skipped: $tool is not installed"; exit 0; }; done
[ "$(id -u)" = 0 ] || { echo "skipped: a chroot needs root"; exit 0; }
work=$(mktemp -d)
root=$work/root
finish() {
    umount "$root/proc" "$root/dev/shm" 2>/dev/null || true
    rm -rf --one-file-system "$work"
}
trap finish EXIT
fail() { echo "failed: $*"; exit 1; }
step() { echo "ok: $*"; }
inside() { chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C.UTF-8 "$@"; }

debootstrap --variant=minbase --include=systemd,udev bookworm "$root" >"$work/log" 2>&1 || { tail "$work/log"; exit 1; }
mount -t proc proc "$root/proc"
mount -t tmpfs tmpfs "$root/dev/shm"
cp "$package" "$root/lumiscan.deb"

inside dpkg -i /lumiscan.deb >"$work/log" 2>&1 || { cat "$work/log"; fail "it does not install"; }
inside lumiscan --version | grep -q "$(dpkg-deb -f "$package" Version | sed 's/.*\.//')" || fail "--version does not say the commit"
inside id lumiscan >/dev/null || fail "no user lumiscan"
[ "$(inside stat -c '%U %a' /var/lib/lumiscan)" = "lumiscan 750" ] || fail "/var/lib/lumiscan"
[ "$(inside systemctl is-enabled lumiscan.service)" = enabled ] || fail "the service is not enabled"
inside lumiscan config --config /etc/lumiscan/default.toml >/dev/null || fail "the configuration is refused"
# The tools of a package's contents say nothing against the units.
inside systemd-analyze verify /lib/systemd/system/lumiscan.service 2>"$work/log" || { cat "$work/log"; fail "the unit"; }
for file in /usr/share/man/man1/lumiscan.1.gz /usr/share/bash-completion/completions/lumiscan \
    /usr/share/doc/lumiscan/copyright /usr/share/doc/lumiscan/sbom.cdx.json; do
    inside test -s $file || fail "$file is missing"
done
step "installed: $(inside lumiscan --version)"

# As the unit starts it, with a simulated Kinect.
inside setpriv --reuid lumiscan --regid lumiscan --init-groups timeout -s TERM 20 lumiscan capture --device /var/lib/lumiscan \
    --socket /var/lib/lumiscan/control --config /etc/lumiscan/default.toml --auto --set serve.address= \
    --simulate pattern >"$work/daemon" 2>&1 &
daemon=$!
for _ in $(seq 40); do
    grep -q '"state": *"ready"' "$root/var/lib/lumiscan/status.json" 2>/dev/null && break
    sleep 0.5
done
grep -q '"state": *"ready"' "$root/var/lib/lumiscan/status.json" || { cat "$work/daemon"; fail "the daemon is not ready"; }
wait $daemon || [ $? = 124 ] || { cat "$work/daemon"; fail "the daemon ended with an error"; }
step "started, ready and ended"

# A later version, beside a scan and a changed configuration.
mkdir "$root/var/lib/lumiscan/scans/20261121T110534Z-scan-0001"
echo "scan" >"$root/var/lib/lumiscan/scans/20261121T110534Z-scan-0001/scan.lscan"
echo "# changed here" >>"$root/etc/lumiscan/default.toml"
dpkg-deb -R "$package" "$work/later"
sed -i 's/^Version: .*/&.1/' "$work/later/DEBIAN/control"
dpkg-deb --root-owner-group --build "$work/later" "$root/later.deb" >/dev/null
inside dpkg -i --force-confold /later.deb >"$work/log" 2>&1 || { cat "$work/log"; fail "it does not upgrade"; }
kept=/var/lib/lumiscan/scans/20261121T110534Z-scan-0001/scan.lscan
inside test -s $kept || fail "the upgrade lost a scan"
grep -q "# changed here" "$root/etc/lumiscan/default.toml" || fail "the upgrade lost the configuration"
step "upgraded, with scan and configuration"

inside dpkg --purge lumiscan >"$work/log" 2>&1 || { cat "$work/log"; fail "it does not purge"; }
inside test -s $kept || fail "purging deleted a scan"
for gone in /usr/bin/lumiscan /etc/lumiscan/default.toml /lib/systemd/system/lumiscan.service /var/lib/lumiscan/status.json; do
    inside test ! -e $gone || fail "$gone is left"
done
rm -r "$root/var/lib/lumiscan"
inside dpkg -i /lumiscan.deb >"$work/log" 2>&1 && inside dpkg --purge lumiscan >>"$work/log" 2>&1 || { cat "$work/log"; fail "a second round"; }
inside test ! -e /var/lib/lumiscan || fail "an empty /var/lib/lumiscan is left"
step "purged; scans are left, and nothing where there were none"
