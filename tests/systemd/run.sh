#!/usr/bin/env bash
# The unit `contrib/vservo@.service` under a real systemd, in namespaces of its own: a copy of this system's root (overlay, in memory), its own processes,
# /run, /dev/shm and control groups. Nothing outside changes, and nothing is left.
#
#     tests/systemd/run.sh FOLDER_WITH_THE_BINARY_VSERVO
#
# Exit code 0: all held; 1: something did not; 77: this machine cannot (no root, no systemd, no overlay), and says why.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
binaries=$(realpath "$1")
systemd=/lib/systemd/systemd

cannot() { echo "not tested: $1"; exit 77; }
[ "$(id -u)" = 0 ] || cannot "namespaces need root"
[ -x "$systemd" ] || cannot "no systemd at $systemd"
command -v systemctl >/dev/null || cannot "no systemctl"
[ -x "$binaries/vservo" ] || { echo "no vservo in $binaries" >&2; exit 1; }

scratch=$(mktemp -d)
machine=
finish() {
    # Its systemd, the first process of its namespace, ends with it, and all others with that.
    [ -z "$machine" ] || kill -KILL "$machine" 2>/dev/null || true
    [ -z "$machine" ] || wait "$machine" 2>/dev/null || true
    rm -rf "$scratch"
}
trap finish EXIT

unshare --mount --pid --fork --cgroup --propagation private --kill-child=KILL \
    bash "$here/boot.sh" "$scratch" "$systemd" "$binaries" "$here/../.." >"$scratch/console" 2>&1 &
machine=$!

inside() { timeout --signal=KILL "$1" nsenter --target "$first" --mount --pid --cgroup --root --wd "${@:2}"; }
for _ in $(seq 100); do
    first=$(pgrep --parent "$machine" || true)
    state=$([ -z "$first" ] || inside 10 systemctl is-system-running 2>/dev/null || true)
    case $state in running | degraded) break ;; esac
    kill -0 "$machine" 2>/dev/null || cannot "systemd did not start: $(tail -n 3 "$scratch/console")"
    sleep 0.3
done
case $state in running | degraded) ;; *) cannot "systemd came to the state \`$state\`: $(tail -n 3 "$scratch/console")" ;; esac
"$systemd" --version | head -n 1

inside 300 bash -s <"$here/scenario.sh"
