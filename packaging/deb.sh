#!/usr/bin/env bash
# A Debian package of the executable and what the system needs to know of it: target/debian/lumiscan_VERSION_ARCH.deb.
#
#   packaging/deb.sh amd64|arm64 [--executable FILE]
#
# Builds the executable, or takes one that was built for the same commit. The same commit gives the same bytes, wherever the
# repository lies. Needs dpkg-deb, git, python3 and a linker for the architecture.
set -euo pipefail
cd "$(dirname "$0")/.."
usage() { sed -n '4s/^# *//p' "$0" >&2; exit 2; }
case "${1:-}" in
amd64) target=x86_64-unknown-linux-gnu tools=x86_64-linux-gnu ;;
arm64) target=aarch64-unknown-linux-gnu tools=aarch64-linux-gnu ;;
*) usage ;;
esac
arch=$1 executable=
if [ $# -gt 1 ]; then
    [ "$2" = --executable ] && [ $# -eq 3 ] || usage
    executable=$(realpath "$3")
fi

SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
LUMISCAN_COMMIT=$(git rev-parse --short=12 HEAD)
# Sorted the same everywhere.
export SOURCE_DATE_EPOCH LUMISCAN_COMMIT LC_ALL=C
umask 022
out=$PWD/target/debian
mkdir -p "$out"
if [ -z "$executable" ]; then
    # No path of this machine in the executable.
    map="--remap-path-prefix=$PWD=/lumiscan --remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=/cargo"
    export RUSTFLAGS="$map -Clink-arg=-Wl,--build-id=none" CFLAGS="-ffile-prefix-map=$PWD=/lumiscan -ffile-prefix-map=${CARGO_HOME:-$HOME/.cargo}=/cargo"
    [ "$arch" = arm64 ] && export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
    cargo build --release --locked -p capture --bin lumiscan --target "$target" --target-dir "$out/build"
    executable=$out/build/$target/release/lumiscan
fi

root=$(mktemp -d "$out/root.XXXXXX")
trap 'rm -rf "$root"' EXIT
chmod 755 "$root"
put() { install -D -m "$1" "$2" "$root/$3"; }
appliance=firmware-config/appliance
put 755 "$executable" usr/bin/lumiscan
$tools-strip --strip-all "$root/usr/bin/lumiscan"
put 644 $appliance/default.toml etc/lumiscan/default.toml
for unit in lumiscan.service lumiscan-stick@.service lumiscan-handoff.service lumiscan-handoff.timer lumiscan-handoff.path; do
    put 644 $appliance/$unit lib/systemd/system/$unit
done
for rules in 60-lumiscan.rules 61-lumiscan-stick.rules; do put 644 $appliance/$rules lib/udev/rules.d/$rules; done
put 644 $appliance/lumiscan.sysusers usr/lib/sysusers.d/lumiscan.conf
put 644 $appliance/lumiscan.tmpfiles usr/lib/tmpfiles.d/lumiscan.conf
put 644 $appliance/INSTALL.md usr/share/doc/lumiscan/INSTALL.md
python3 packaging/dependencies.py "$target" "$root/usr/share/doc/lumiscan/copyright" "$root/usr/share/doc/lumiscan/sbom.cdx.json"
chmod 644 "$root"/usr/share/doc/lumiscan/*

# The command line's own description; that of another architecture runs under qemu-user.
run=
[ "$(uname -m)-$arch" = x86_64-arm64 ] && run="qemu-aarch64-static -L /usr/aarch64-linux-gnu"
manual=$root/manual
$run "$executable" manual "$manual"
for page in "$manual"/*.1; do
    gzip -9n "$page"
    put 644 "$page.gz" "usr/share/man/man1/${page##*/}.gz"
done
put 644 "$manual/lumiscan.bash" usr/share/bash-completion/completions/lumiscan
put 644 "$manual/_lumiscan" usr/share/zsh/vendor-completions/_lumiscan
put 644 "$manual/lumiscan.fish" usr/share/fish/vendor_completions.d/lumiscan.fish
rm -r "$manual"

version=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"/\1/p' Cargo.toml)
# Later commits are upgrades.
version="$version+$(date -u -d "@$SOURCE_DATE_EPOCH" +%Y%m%d%H%M%S).$LUMISCAN_COMMIT"
# The newest version of a symbol that the executable asks for.
libc=$($tools-objdump -T "$root/usr/bin/lumiscan" | grep -o 'GLIBC_[0-9.]*' | sort -V | tail -1)
# In KiB, as dpkg-gencontrol counts: folders as one, whatever the file system takes for them.
size=$(find "$root" -printf '%y %s\n' | awk '{ n += $1 == "f" ? int(($2 + 1023) / 1024) : 1 } END { print n }')
mkdir "$root/DEBIAN"
cat >"$root/DEBIAN/control" <<CONTROL
Package: lumiscan
Version: $version
Architecture: $arch
Maintainer: the authors of Lumiscan <lumiscan@localhost>
Installed-Size: $size
Depends: libc6 (>= ${libc#GLIBC_}), libgcc-s1, systemd (>= 247)
Suggests: rsync, openssh-client, ffmpeg
Section: graphics
Priority: optional
Description: light and materials from casual scans with a Kinect
 Scans with a Kinect V1, and estimates the mesh, its materials and the light that
 falls on it. The service scans by itself when the Kinect is moved.
CONTROL
echo /etc/lumiscan/default.toml >"$root/DEBIAN/conffiles"
for script in postinst prerm postrm; do put 755 packaging/$script DEBIAN/$script; done
(cd "$root" && find . -path ./DEBIAN -prune -o -type f -print | sort | sed 's|^\./||' | xargs -d '\n' md5sum) >"$root/md5sums"
mv "$root/md5sums" "$root/DEBIAN/md5sums"
find "$root" -newermt "@$SOURCE_DATE_EPOCH" -exec touch -h -d "@$SOURCE_DATE_EPOCH" {} +
package=$out/lumiscan_${version}_$arch.deb
dpkg-deb --root-owner-group -Zxz --build "$root" "$package" >/dev/null
echo "$package"
