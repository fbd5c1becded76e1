# Runs inside, by `bash -s`: what docs/operation.md promises of the unit, in order.
set -euo pipefail
binaries=/run/binaries
repository=/run/repository

fail() {
    echo "FAILED: $1" >&2
    journalctl --no-pager --lines 30 --output cat --unit vservo@cell --unit vservo@bad | cut -c1-300 >&2
    exit 1
}
property() { systemctl show --value --property "$2" "vservo@$1"; }
# Waits until a command succeeds, for so many seconds.
within() {
    local end=$((SECONDS + $1))
    shift
    until "$@" >/dev/null 2>&1; do
        [ "$SECONDS" -lt "$end" ] || return 1
        sleep 0.1
    done
}
ctl() { timeout 60 runuser --user vservo -- vservo ctl "$@" --instance cell; }
is() { [ "$(property "$1" "$2")" = "$3" ]; }
nothing_left() { [ -z "$(ls /dev/shm)" ] && ! pgrep --exact 'vservo.*'; }

# What the Debian package installs, where it does (Cargo.toml), and its script.
install -m 755 "$binaries"/vservo /usr/bin/
install -m 644 "$repository/contrib/vservo@.service" /usr/lib/systemd/system/
install -D -m 644 "$repository/contrib/vservo.sysusers" /usr/lib/sysusers.d/vservo.conf
systemd-sysusers
systemctl daemon-reload
install -D -m 644 "$repository/config/ur5.toml" /etc/vservo/cell.toml
id vservo >/dev/null || fail "the package makes no user vservo"
systemd-analyze verify --man=no vservo@cell.service || fail "systemd finds fault with the unit"

systemctl start vservo@cell || fail "it does not start"
is cell ActiveState active || fail "started, and not active"
ctl status | grep -q idle || fail "it is not idle after its start"
ctl start && ctl wait converged --timeout-s 60 || fail "the arm does not come to its goal"
echo "ok: ready when control ticks, idle until told to start, converges"

systemctl restart vservo@cell && ctl start >/dev/null || fail "it does not start again"
systemctl stop vservo@cell || fail "it does not stop"
is cell Result success || fail "a stop is no success: $(property cell Result)"
within 5 nothing_left || fail "left after a stop: $(ls /dev/shm)"
journalctl --no-pager --output cat --unit vservo@cell | grep -q 'flock:' && fail "the wait for control complains"
echo "ok: a stop in motion ends in order, and leaves nothing"

echo 'nonsense = 1' >/etc/vservo/bad.toml
systemctl start vservo@bad 2>/dev/null && fail "a wrong run file starts"
sleep 2
is bad ActiveState failed && is bad NRestarts 0 && is bad ExecMainStatus 3 || fail "a wrong run file is tried again"
echo "ok: a wrong run file is not tried again"

systemctl start vservo@cell
ctl start >/dev/null
kill -KILL "$(property cell MainPID)"
within 20 is cell NRestarts 1 && within 20 is cell ActiveState active || fail "no new start after the supervisor's death"
ctl status | grep -q idle || fail "it moves after a restart without being told to"
echo "ok: killed, it comes back idle"

ctl start >/dev/null
kill -STOP "$(property cell MainPID)"
within 40 is cell NRestarts 2 && within 20 is cell ActiveState active || fail "a supervisor that hangs is not noticed"
ctl status | grep -q idle || fail "it moves after a restart without being told to"
echo "ok: a supervisor that hangs is ended by the watchdog, and comes back idle"

ctl start >/dev/null
pkill -KILL --full 'vservo control'
within 20 is cell ActiveState failed || fail "a run whose control died goes on: $(property cell ActiveState)"
is cell ExecMainStatus 4 || fail "its exit code is $(property cell ExecMainStatus)"
within 5 nothing_left || fail "left after control's death: $(ls /dev/shm)"
echo "ok: where control was killed a person must look: no new start, nothing left"
