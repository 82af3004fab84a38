#!/bin/sh
# Upgrades an installed gateway while three simulated vehicles fly: by the package, back, and by the tarball. Needs root and a checkout that
# bin/test has set up.
#
#   debootstrap --variant=minbase bookworm /var/tmp/bare
#   git worktree add /tmp/before HEAD~1 && (cd /tmp/before && bin/release --deb)
#   bin/release --deb
#   test/install/upgrade.sh /var/tmp/bare /tmp/before/_build/release _build/release
#
# It works on a copy of the root, in namespaces of its own. systemd does not run there: test/peers/service_manager.py stands for it, with its
# rules for the main process. It prints the longest time for which a program at NATS missed a vehicle.
set -eu
here=$(cd "$(dirname "$0")/../.." && pwd -P)
[ "${4:-}" = inside ] || {
  [ $# -eq 3 ] && [ -x "$1/usr/bin/dpkg" ] || { sed -n '2,11s/^# \{0,1\}//p' "$0" >&2; exit 2; }
  root=$(mktemp -d -p "${TMPDIR:-/var/tmp}")
  trap 'rm -rf --one-file-system "$root"' EXIT
  cp -a "$1/." "$root/"
  cp "$2"/*.deb "$root/root/before.deb"
  cp "$3"/*.deb "$root/root/after.deb"
  cp "$3"/*.tar.gz "$3"/*.sha256 "$root/root/"
  # All processes end with the first one.
  unshare --mount --pid --net --fork --kill-child sh -c '
    ip link set lo up
    mount -t proc proc "$1/proc"
    mount --bind /dev "$1/dev"
    mount -t proc proc /proc
    exec "$2" "$1" "" "" inside' sh "$root" "$0"
  exit
}

root=$1
export PATH="$here/.toolchain/bin:$PATH" MIX_HOME="$here/.mix" MIX_ENV=test ELIXIR_ERL_OPTIONS=+fnu
python=$here/.venv/bin/python
step() { echo "== $*"; }
fail() { echo "FAILED: $*" >&2; exit 1; }
inside() { chroot "$root" env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin "$@"; }
as_aerie() { inside setpriv --reuid aerie --regid aerie --init-groups env -i PATH=/usr/bin:/bin AERIE_HOME=/var/lib/aerie "$@"; }
flying() { inside aerie rpc 'Enum.count(Aerie.Base.Store.vehicles(:default), & &1.groups[:mode][:data][:in_air])' 2>&1; }
three() {
  tries=0
  until [ "$(flying)" = 3 ]; do
    tries=$((tries + 1))
    [ $tries -lt 240 ] || { tail -20 "$root/root/log"; fail "three should fly, and '$(flying)' do"; }
    sleep 0.5
  done
}
in_force() { readlink "$root/opt/aerie"; }

# gap COMMAND ...: how long a program at NATS misses a vehicle while the command runs, and ten seconds more
gap() {
  "$python" - <<'PY' &
import asyncio, time
import nats
last, worst = {}, 0.0
async def heard(message):
    global worst
    now = time.monotonic()
    worst = max(worst, now - last.get(message.subject, now))
    last[message.subject] = now
async def quiet(_error):
    pass
async def main():
    client = await nats.connect("nats://a-token-for-a-test@127.0.0.1:4222", reconnect_time_wait=0.02, max_reconnect_attempts=-1, error_cb=quiet)
    await client.subscribe("fleet.test.*.state.attitude", cb=heard)
    await asyncio.sleep(25)
    print(f"the longest gap of {len(last)} vehicles: {worst:.2f} s", flush=True)
asyncio.run(main())
PY
  listener=$!
  sleep 2
  "$@"
  wait $listener
}

step "the former version is installed, and three vehicles fly"
inside dpkg --install /root/before.deb
cat >"$root/etc/aerie/gateway.yaml" <<'YAML'
environment: test
links: [{id: radio, url: "udpin:127.0.0.1:14550"}]
nats: {port: 4222, token: a-token-for-a-test}
sampling: {groups: {attitude: {strategy: time, hz: 10}}}
YAML
chroot "$root" chown root:aerie /etc/aerie/gateway.yaml
before=$(in_force)
"$python" "$here/test/peers/service_manager.py" "$(command -v chroot)" "$root" /usr/bin/setpriv --reuid aerie --regid aerie --init-groups \
  /usr/bin/env AERIE_HOME=/var/lib/aerie AERIE_CONFIG=/etc/aerie/gateway.yaml /opt/aerie/bin/aerie start >"$root/root/log" 2>&1 &
manager=$!
(cd "$here/apps/sim_vehicle" && exec mix sim.fleet --count 3 --firmware ardupilot --to udpout:127.0.0.1:14550) >"$root/root/vehicles" 2>&1 </dev/null &
three

step "by the package"
gap inside dpkg --install /root/after.deb
after=$(in_force)
[ "$after" != "$before" ] || fail "the same version is in force: $after"
three
step "back"
gap inside aerie upgrade --back
[ "$(in_force)" = "$before" ] || fail "$(in_force) is in force, not $before"
three
step "by the tarball"
gap inside sh -c 'aerie upgrade /root/aerie-*.tar.gz'
[ "$(in_force)" = "$after" ] || fail "$(in_force) is in force, not $after"
three

step "while somebody is in charge, nothing is changed"
as_aerie aerie cmd VID-002 take_control --yes
status=0
inside aerie upgrade --back || status=$?
[ $status = 4 ] && [ "$(in_force)" = "$after" ] || fail "status $status, $(in_force) is in force"

step "the service manager saw no end of the main process"
! grep 'the main process ended' "$root/root/log" || fail "it did"
kill $manager
wait $manager || true
[ "$(ls "$root/opt/aerie-versions" | grep -c -e -)" = 2 ] || fail "versions: $(ls "$root/opt/aerie-versions")"
inside dpkg --purge aerie
[ ! -e "$root/opt/aerie-versions" ] || fail "versions are left"
echo "== all well"
