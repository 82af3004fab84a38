#!/bin/sh
# Installs what `bin/release --deb` has made into a bare Debian, uses it and removes it, by dpkg and by install.sh. Needs root.
#
#   debootstrap --variant=minbase --include=systemd,udev bookworm /var/tmp/bare
#   bin/release --deb
#   test/install/try.sh /var/tmp/bare [FOLDER]       # FOLDER: bin/release's --output, by default _build/release
#
# It works on a copy of the root, in namespaces of its own: no process, port or file of it is left. systemd does not run there, so the
# gateway is started as the unit would start it.
set -eu
[ "${2:-}" = inside ] || {
  [ $# -ge 1 ] && [ -x "$1/usr/bin/dpkg" ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
  here=$(cd "$(dirname "$0")" && pwd -P)
  made=${2:-$here/../../_build/release}
  root=$(mktemp -d -p "${TMPDIR:-/var/tmp}")
  trap 'rm -rf --one-file-system "$root"' EXIT
  cp -a "$1/." "$root/"
  cp "$made"/*.deb "$made"/*.tar.gz "$root/root/"
  cp "$0" "$root/root/try.sh"
  # All processes end with the first one.
  unshare --mount --pid --net --fork --kill-child sh -c '
    ip link set lo up
    mount -t proc proc "$1/proc"
    mount --bind /dev "$1/dev"
    exec chroot "$1" /usr/bin/env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin sh /root/try.sh / inside' sh "$root"
  exit
}

cd /root
step() { echo "== $*"; }
fail() { echo "FAILED: $*" >&2; exit 1; }
is() { [ "$2" = "$3" ] || fail "$1: expected '$3', got '$2'"; }
be_aerie() { exec setpriv --reuid aerie --regid aerie --init-groups env -i PATH=/usr/bin:/bin AERIE_HOME=/var/lib/aerie "$@"; }
as_aerie() { (be_aerie "$@"); }

# get PATH: the status of the gateway's answer
get() { bash -c 'exec 3<>/dev/tcp/127.0.0.1/4000 && printf "GET %s HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n" "$1" >&3 && head -n 1 <&3' bash "$1" 2>/dev/null | cut -d ' ' -f 2; }

# What the unit sets, as far as it matters without systemd.
use() {
  step "the gateway starts as its user, and is ready"
  cd /var/lib/aerie
  be_aerie AERIE_CONFIG=/etc/aerie/gateway.yaml /opt/aerie/bin/aerie start </dev/null >/root/log 2>&1 &
  gateway=$!
  cd /root
  tries=0
  until [ "$(get /readyz)" = 200 ]; do
    tries=$((tries + 1))
    [ $tries -lt 120 ] && kill -0 $gateway 2>/dev/null || { cat /root/log; fail "no answer 200 from /readyz, but '$(get /readyz)'"; }
    sleep 0.5
  done
  is "the console" "$(get /sign-in)" 200
  as_aerie aerie status || fail "aerie status: $?"
  as_aerie aerie doctor --config /etc/aerie/gateway.yaml || echo "(doctor: $?)"
  is "what xz the gateway finds" "$(as_aerie aerie rpc 'System.find_executable("xz")')" "\"$(readlink -f /opt/aerie)/bin/xz\""
  # Nobody has to know where the service keeps its files; who may not read them is told whose they are.
  env -i PATH=/usr/bin:/bin aerie status || fail "aerie status of root: $?"
  # Others than the gateway's user do not reach it.
  useradd --no-create-home other
  setpriv --reuid other --regid other --clear-groups env -i PATH=/usr/bin:/bin aerie status 2>&1 | grep -q 'sudo -u aerie aerie' || fail "another user is not told"
  ! setpriv --reuid other --regid other --clear-groups env -i PATH=/usr/bin:/bin AERIE_HOME=/var/lib/aerie aerie rpc 1 2>/dev/null || fail "another user reached the gateway"
  userdel other
  # As systemctl stop.
  kill $gateway
  wait $gateway || fail "it ended with $?"
  [ -d /var/lib/aerie/var ] || fail "nothing was kept"
  ! find /var/lib/aerie -not -user aerie | grep . || fail "files of others in /var/lib/aerie"
}

installed() {
  is "the user's groups" "$(id -Gn aerie)" "aerie dialout"
  is "mode of /etc/aerie" "$(stat -c '%a %U %G' /etc/aerie)" "750 root aerie"
  is "mode of gateway.yaml" "$(stat -c '%a %U %G' /etc/aerie/gateway.yaml)" "640 root aerie"
  is "mode of /var/lib/aerie" "$(stat -c '%a %U %G' /var/lib/aerie)" "700 aerie aerie"
  ! find /opt/aerie/ -perm /022 -not -type l | grep . || fail "others may write the program"
  [ -e /lib/udev/rules.d/60-aerie.rules ] || fail "no rules for udev"
  ! command -v systemd-analyze >/dev/null || systemd-analyze verify /lib/systemd/system/aerie.service || fail "the unit"
  for link in /usr/share/man/man1/aerie.1 /usr/share/bash-completion/completions/aerie; do [ -s $link ] || fail "no $link"; done
  is "version" "$(aerie version | cut -d ' ' -f 1)" aerie
}

left() {
  [ ! -e /opt/aerie ] && [ ! -e /opt/aerie-versions ] && [ ! -L /usr/bin/aerie ] && [ ! -L /usr/share/man/man1/aerie.1 ] && [ ! -e /lib/systemd/system/aerie.service ] || fail "the program is still there"
  grep -q kept /etc/aerie/gateway.yaml || fail "the configuration is gone"
  [ -d /var/lib/aerie/var ] || fail "the data are gone"
}

step "dpkg installs"
dpkg --install ./*.deb
installed
use
step "dpkg installs again: configuration and data stay"
echo '# kept' >>/etc/aerie/gateway.yaml
dpkg --install ./*.deb
installed
step "dpkg removes: configuration and data stay"
dpkg --remove aerie
left
step "dpkg installs and purges: nothing stays"
dpkg --install ./*.deb
installed
dpkg --purge aerie
for path in /opt/aerie /opt/aerie-versions /usr/lib/aerie /etc/aerie /var/lib/aerie /usr/bin/aerie /usr/share/man/man1/aerie.1; do [ ! -e $path ] || fail "$path is still there"; done
! getent passwd aerie || fail "the user is still there"
! getent group aerie || fail "the group is still there"

step "install.sh installs"
tar -xzf ./*.tar.gz
./aerie-*/install.sh
installed
use
step "install.sh installs again, and removes: configuration and data stay"
echo '# kept' >>/etc/aerie/gateway.yaml
./aerie-*/install.sh --no-start
installed
/opt/aerie/install.sh --uninstall
left
echo "== all well"
