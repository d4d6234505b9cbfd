#!/bin/sh
# Builds a disk image with Debian 12, as Raspberry Pi OS has it, and the package of veilcam installed:
# build-image.sh ARCHITECTURE FOLDER. What is in FOLDER already is used again.
# The kernel is Debian's newest, since gpio-sim is not in that of Debian 12.
# Programs of another processor than this machine's are handed to QEMU by an entry in binfmt_misc, which
# run.py makes.
set -eu

architecture=$1
here=$(cd "$(dirname "$0")" && pwd)
project=$(cd "$here/../../.." && pwd)
mkdir -p "$2"
cd "$2"
mirror=http://deb.debian.org/debian
say() { echo "image: $*"; }

if [ ! -e base.tar ]; then
    say "Debian 12 with systemd and Python (some minutes)"
    mmdebstrap --quiet --arch="$architecture" --format=tar --variant=minbase \
        --include=systemd,systemd-sysv,udev,kmod,dbus \
        --include=python3-numpy,python3-spidev,openssl,gcc,libc6-dev,libfuse3-dev,pkg-config,busybox-static \
        bookworm base.tar.part "$mirror"
    mv base.tar.part base.tar
fi

if [ ! -e kernel.tar ]; then
    say "kernel"
    # Mirrors that stand still for a while still hold what Debian signed.
    mmdebstrap --quiet --arch="$architecture" --format=tar --variant=extract \
        --aptopt='Acquire::Check-Valid-Until "false"' \
        --include="?name(^linux-modules-[0-9.]+.deb[0-9]+-$architecture\$)" \
        --include="?name(^linux-binary-[0-9.]+.deb[0-9]+-$architecture\$)" \
        forky kernel.tar.part "$mirror"
    mv kernel.tar.part kernel.tar
fi

# Light is simulated with these, which no device has.
if [ ! -e light/complete ]; then
    say "what light is simulated with"
    install() { "${PYTHON:-python3.11}" -m pip install --quiet --target light "$@"; }
    case $architecture in
    amd64) install torch scipy matplotlib pillow ;;
    arm64)
        # pip asks this machine, not the other, which of torch's requirements apply; so they are named. 2.9.1
        # is the last whose wheel on the Python Package Index is built for the CPU alone.
        foreign="--only-binary=:all: --implementation=cp --python-version=3.11
            --platform=manylinux_2_28_aarch64 --platform=manylinux_2_17_aarch64"
        # shellcheck disable=SC2086 # they are several
        install $foreign --no-deps torch==2.9.1
        # shellcheck disable=SC2086
        install $foreign scipy matplotlib pillow filelock typing-extensions sympy networkx jinja2 fsspec
        ;;
    esac
    touch light/complete
fi

git -C "$project" describe --always --dirty --abbrev=12 --exclude='*' > commit
say "the package"
rm -rf root packages
(cd "$project" && "${BUILDER:-python3}" -m deploy.debian.build --architecture "$architecture" --out "$OLDPWD/packages")
mkdir -p root/srv
tar -C root -xf base.tar --exclude='./dev/*'
mknod -m 666 root/dev/null c 1 3
mknod -m 666 root/dev/urandom c 1 9
tar -C root --keep-directory-symlink -xf kernel.tar --wildcards './usr/lib/modules/*' \
    || tar -C root --keep-directory-symlink -xf kernel.tar --wildcards './lib/modules/*'
cp packages/veilcam_*_"$architecture".deb root/srv/
# With a /proc, which systemd-tmpfiles asks for, and which goes with the command.
inside() {
    unshare --mount sh -c 'mount -t proc proc root/proc && exec chroot root env -i "$@"' - \
        PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 "$@"
}
inside sh -c 'dpkg --install /srv/veilcam_*.deb'
mkdir -p root/usr/local/lib/python3.11/dist-packages
cp -r light/. root/usr/local/lib/python3.11/dist-packages

say "what the checks need"
cp "$here/spidev.c" root/srv/
inside sh -c 'gcc -Wall -Wextra -Werror -O1 -o /usr/local/bin/spidev-in-user-space /srv/spidev.c \
    $(pkg-config --cflags --libs fuse3)'
mkdir -p root/usr/local/lib/veilcam-checks/guest
cp "$project/deploy/README.md" root/usr/local/lib/veilcam-checks/
cp "$here"/guest/*.py root/usr/local/lib/veilcam-checks/guest/
cp "$here"/guest/*.service root/etc/systemd/system/
install -D -m 644 "$here/guest/virtual-machine.conf" \
    root/etc/systemd/system/veilcamd.service.d/virtual-machine.conf
cp "$here/guest/veilcam.env" root/etc/veilcam/veilcam.env
inside systemctl --quiet enable veilcam-prepare.service veilcam-checks.service
inside systemctl --quiet mask serial-getty@.service getty@.service systemd-timesyncd.service
rm -rf root/srv/*

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
