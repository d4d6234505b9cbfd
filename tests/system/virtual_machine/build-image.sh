#!/bin/sh
# Builds a disk image with Debian 12, as Raspberry Pi OS has it, and veilcamd installed by
# deploy/install.sh: build-image.sh FOLDER. What is in FOLDER already is used again.
# The kernel is Debian's newest, since gpio-sim is not in that of Debian 12.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
project=$(cd "$here/../../.." && pwd)
mkdir -p "$1"
cd "$1"
mirror=http://deb.debian.org/debian
say() { echo "image: $*"; }

if [ ! -e base.tar ]; then
    say "Debian 12 with systemd and Python (some minutes)"
    mmdebstrap --quiet --format=tar --variant=minbase --include=systemd,systemd-sysv,udev,kmod,dbus \
        --include=python3-venv,python3-dev,gcc,libc6-dev,libfuse3-dev,pkg-config,busybox-static \
        bookworm base.tar.part "$mirror"
    mv base.tar.part base.tar
fi

if [ ! -e kernel.tar ]; then
    say "kernel"
    # Mirrors that stand still for a while still hold what Debian signed.
    mmdebstrap --quiet --format=tar --variant=extract \
        --aptopt='Acquire::Check-Valid-Until "false"' \
        --include='?name(^linux-modules-[0-9.]+.deb[0-9]+-amd64$)' \
        --include='?name(^linux-binary-[0-9.]+.deb[0-9]+-amd64$)' \
        forky kernel.tar.part "$mirror"
    mv kernel.tar.part kernel.tar
fi

# Packages for Python, as pip on this machine finds them; nothing is downloaded in the image.
if [ ! -e wheels/complete ]; then
    say "Python packages"
    "${PYTHON:-python3.11}" -m pip download --quiet --dest wheels --no-binary spidev \
        "$project[server]" spidev gpiod hatchling setuptools wheel
    touch wheels/complete
fi

git -C "$project" describe --always --dirty --abbrev=12 --exclude='*' > commit
say "installing veilcamd with deploy/install.sh"
rm -rf root
mkdir -p root/tmp/veilcam
tar -C root -xf base.tar --exclude='./dev/*'
mknod -m 666 root/dev/null c 1 3
mknod -m 666 root/dev/urandom c 1 9
tar -C root --keep-directory-symlink -xf kernel.tar --wildcards './usr/lib/modules/*' \
    || tar -C root --keep-directory-symlink -xf kernel.tar --wildcards './lib/modules/*'
cp -r wheels root/tmp/wheels
cd "$project"
tar -cf - --exclude=__pycache__ pyproject.toml README.md LICENSE client optics training server \
    deploy | tar -C "$OLDPWD/root/tmp/veilcam" -xf -
cd "$OLDPWD"
inside() { chroot root env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 "$@"; }
inside PIP_NO_INDEX=1 PIP_FIND_LINKS=/tmp/wheels /tmp/veilcam/deploy/install.sh
# What a Raspberry Pi would have got by itself.
inside /opt/veilcam/current/bin/pip install --quiet --no-index --find-links /tmp/wheels spidev gpiod

say "what the checks need"
cp "$here/spidev.c" root/tmp/
inside sh -c 'gcc -Wall -Wextra -Werror -O1 -o /usr/local/bin/spidev-in-user-space /tmp/spidev.c \
    $(pkg-config --cflags --libs fuse3)'
mkdir -p root/usr/local/lib/veilcam-checks/guest
cp "$project/deploy/uninstall.sh" "$project/deploy/README.md" root/usr/local/lib/veilcam-checks/
cp "$here"/guest/*.py root/usr/local/lib/veilcam-checks/guest/
cp "$here"/guest/*.service root/etc/systemd/system/
install -D -m 644 "$here/guest/virtual-machine.conf" \
    root/etc/systemd/system/veilcamd.service.d/virtual-machine.conf
cp "$here/guest/veilcam.env" root/etc/veilcam/veilcam.env
inside systemctl --quiet enable veilcam-prepare.service veilcam-checks.service
inside systemctl --quiet mask serial-getty@ttyS0.service getty@.service systemd-timesyncd.service
rm -rf root/tmp/*

say "initial file system"
version=$(ls root/usr/lib/modules | sort -V | tail -n 1)
inside depmod "$version"
cp "root/usr/lib/modules/$version/vmlinuz" vmlinuz
rm -rf early
mkdir -p early/bin early/proc early/root
cp root/usr/bin/busybox early/bin/busybox 2>/dev/null || cp root/bin/busybox early/bin/busybox
inside modprobe --show-depends --set-version "$version" virtio_blk > modules
inside modprobe --show-depends --set-version "$version" ext4 >> modules
{
    echo '#!/bin/busybox sh'
    while read -r _ module _; do
        name=$(basename "${module%.xz}")
        xz -dc "root$module" > "early/$name"
        echo "/bin/busybox insmod /$name"
    done < modules
    echo '/bin/busybox mount -t devtmpfs none /dev 2>/dev/null'
    echo '/bin/busybox mount -o rw -t ext4 /dev/vda /root'
    echo 'exec /bin/busybox switch_root /root /lib/systemd/systemd'
} > early/init
chmod +x early/init
mkdir -p early/dev
(cd early && find . | cpio --quiet -o -H newc | gzip -1) > initrd.gz

say "disk"
rm -f disk.img
mke2fs -q -t ext4 -d root disk.img 3G
rm -rf root early
say "done: $(du -h --apparent-size disk.img | cut -f1), $(du -h disk.img | cut -f1) of it written"
