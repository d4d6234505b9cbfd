#!/bin/sh
# Removes veilcamd: sudo deploy/uninstall.sh
# State and settings stay, unless --purge is given: the device's key and its tokens are among them.
set -eu

[ "$(id -u)" = 0 ] || { echo "uninstall.sh: error: run it as root: sudo $0" >&2; exit 1; }
case ${1:-} in
    '' | --purge) ;;
    *) echo "uninstall.sh: error: $1: the only option is --purge" >&2; exit 1 ;;
esac

if [ -d /run/systemd/system ]; then
    # The panel shows opaque from here on, as long as it has power.
    systemctl stop veilcamd.socket veilcamd.service || true
fi
systemctl disable veilcamd.socket veilcamd.service || true
rm -rf /opt/veilcam /run/veilcam
rm -f /etc/systemd/system/veilcamd.service /etc/systemd/system/veilcamd.socket \
    /etc/udev/rules.d/60-veilcam.rules /etc/sysusers.d/veilcam.conf \
    /etc/avahi/services/veilcam.service
if [ "${1:-}" = --purge ]; then
    rm -rf /var/lib/veilcam /etc/veilcam \
        /etc/systemd/system/veilcamd.service.d /etc/systemd/system/veilcamd.socket.d
    echo "Removed, with state and settings."
else
    echo "Removed. Left: /var/lib/veilcam, /etc/veilcam"
fi
if [ -d /run/systemd/system ]; then systemctl daemon-reload; fi
