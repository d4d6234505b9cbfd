#!/bin/sh
# Installs veilcamd on this machine, or upgrades it: sudo deploy/install.sh
# Run it from a checkout. It may be run again at any time, and keeps settings and state.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
root=/opt/veilcam
python=${PYTHON:-python3}

fail() { echo "install.sh: error: $*" >&2; exit 1; }

[ "$(id -u)" = 0 ] || fail "run it as root: sudo $0"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
    || fail "Python 3.11 or newer is needed: apt install python3"
"$python" -c 'import ensurepip' 2>/dev/null || fail "venv is missing: apt install python3-venv"
version=$(systemctl --version 2>/dev/null | sed -n '1s/systemd \([0-9]*\).*/\1/p')
[ "${version:-0}" -ge 252 ] || fail "systemd 252 or newer is needed, here is ${version:-none}"

extras=server
if grep -qs 'Raspberry Pi' /proc/device-tree/model; then
    extras=server,pi
else
    echo "This is no Raspberry Pi: without the drivers of panel and camera, for --simulate only."
fi

# A release of its own, and one link: an upgrade that fails leaves what runs alone.
name=releases/$(date -u +%Y%m%dT%H%M%SZ)
release=$root/$name
before=$(readlink "$root/current" || true)
mkdir -p "$root/releases"
trap 'rm -rf "$release"' EXIT
echo "Installing into $release"
# libcamera's Python binding comes with the system, not from PyPI.
"$python" -m venv --system-site-packages "$release"
"$release/bin/pip" install --quiet --no-cache-dir \
    --extra-index-url https://download.pytorch.org/whl/cpu "$here/..[$extras]"
"$release/bin/veilcamd" --help >/dev/null
trap - EXIT

install -D -m 644 "$here/veilcam.sysusers" /etc/sysusers.d/veilcam.conf
install -D -m 644 "$here/60-veilcam.rules" /etc/udev/rules.d/60-veilcam.rules
install -D -m 644 "$here/veilcamd.service" /etc/systemd/system/veilcamd.service
install -D -m 644 "$here/veilcamd.socket" /etc/systemd/system/veilcamd.socket
systemd-sysusers /etc/sysusers.d/veilcam.conf
install -d -m 755 /etc/veilcam
[ -e /etc/veilcam/veilcam.env ] || install -m 644 "$here/veilcam.env" /etc/veilcam/veilcam.env

ln -sfn "$name" "$root/current.new"
mv -T "$root/current.new" "$root/current"
for old in "$root"/releases/*; do
    [ "$old" = "$release" ] || [ "$old" = "$root/$before" ] || rm -rf "$old"
done

systemctl enable veilcamd.socket veilcamd.service
if [ -d /run/systemd/system ]; then
    udevadm control --reload && udevadm trigger --subsystem-match=spidev \
        --subsystem-match=gpio --subsystem-match=dma_heap
    systemctl daemon-reload
    if [ -n "$before" ]; then
        systemctl restart veilcamd.socket veilcamd.service
        echo "Upgraded. To go back: ln -sfn $before $root/current && systemctl restart veilcamd"
        exit
    fi
fi
echo "Installed. Next: a bundle and /etc/veilcam/veilcam.env, then: systemctl start veilcamd"
