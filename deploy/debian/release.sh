#!/bin/sh
# Which release of Veilcam runs: the one that was installed last, or, where that one failed to start
# three times, the last one that reached READY.
#
# dpkg unpacks into /usr/lib/veilcam/unpacked, where nothing runs from. A release is a folder of hard
# links to that, so an upgrade takes no file from what runs, and none from what one may go back to.
# What is decided is the administrator's: the daemon cannot write here.
set -eu

unpacked=/usr/lib/veilcam/unpacked
releases=/usr/lib/veilcam/releases
state=/var/lib/veilcam-release
TRIES=3

# The release that a link of $state leads to, or nothing.
at() { readlink "$state/$1" 2>/dev/null || true; }

# A power cut leaves the old link or the new one.
point() {
    ln -sfn "$2" "$state/$1.new"
    mv -T "$state/$1.new" "$state/$1"
}

# Only what runs, and what ran last.
prune() {
    for each in "$releases"/*; do
        [ "$each" = "$(at current)" ] || [ "$each" = "$(at ready)" ] || rm -rf "$each"
    done
}

case ${1:-} in
install) # By the package, once it is unpacked.
    release=$releases/$(cat "$unpacked/RELEASE")
    mkdir -p "$releases" "$state"
    rm -rf "$release.new" "$release.old"
    cp -al "$unpacked" "$release.new"
    [ ! -e "$release" ] || mv -T "$release" "$release.old"
    mv -T "$release.new" "$release"
    rm -f "$state/tries"
    point current "$release"
    prune
    ;;
start) # By systemd, before each start.
    [ "$(at current)" != "$(at ready)" ] || exit 0
    # A line for each, whatever is in it: a power cut leaves no count that could not be read.
    tries=$(cat "$state/tries" 2>/dev/null | wc -l)
    if [ "$tries" -ge "$TRIES" ] && [ -d "$(at ready)" ]; then
        echo "$(at current) did not start $tries times: back to $(at ready)"
        point current "$(at ready)"
        rm -f "$state/tries"
    else
        echo try >> "$state/tries"
    fi
    ;;
ready) # By systemd, once requests are answered.
    [ "$(at current)" != "$(at ready)" ] || exit 0
    point ready "$(at current)"
    rm -f "$state/tries"
    prune
    ;;
remove) # By the package.
    rm -rf "$releases" "$state"
    ;;
*)
    echo "usage: $0 install|start|ready|remove" >&2
    exit 2
    ;;
esac
