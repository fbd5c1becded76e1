#!/usr/bin/env bash
# Becomes the systemd of the namespaces that `run.sh` made. Arguments: an empty folder of the host, the path of systemd, the folder of the binaries, the repository; the last two
# are /run/binaries and /run/repository inside, because /tmp is emptied there.
set -euo pipefail
memory=$1/memory
root=$1/root
mkdir "$memory" "$root"
mount -t tmpfs -o size=2G tmpfs "$memory"
mkdir "$memory/upper" "$memory/work"
mount -t overlay -o "lowerdir=/,upperdir=$memory/upper,workdir=$memory/work" overlay "$root"
cd "$root"
mount -t proc proc proc
mount --rbind /sys sys
mount --rbind /dev dev
for own in dev/shm run tmp; do mount -t tmpfs tmpfs "$own"; done
mkdir run/binaries run/repository
mount --bind "$3" run/binaries
mount --bind "$4" run/repository
umount -R sys/fs/cgroup
mount -t cgroup2 cgroup2 sys/fs/cgroup
# `container` tells systemd that others look after the kernel.
exec chroot . /usr/bin/env -i container=other PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
    "$2" --system --unit=basic.target --log-target=console --show-status=0
