# Bare Debian roots, each with a network of its own. Sourced by run.

# What a user has who clones a repository and calls sudo: nothing of Aerie's.
PACKAGES=ca-certificates,curl,git,iproute2,openssl,procps,sudo
CACHE=${GUIDES_CACHE:-/var/tmp/aerie-guides}
# An ordinary user, whose folder has a name as people give them.
PILOT="/home/pilot/my drone stuff"
PATIENCE=${GUIDES_PATIENCE:-180}

say() { printf '== %s\n' "$*"; }
fail() { printf 'FAILED: %s\n' "$*" >&2; exit 1; }

base_root() { # SUITE: $base is its bare root, made once
  base=$CACHE/$1
  [ ! -e "$base/.complete" ] || return 0
  say "making a bare root of $1"
  mkdir -p "$CACHE"
  rm -rf --one-file-system "$base"
  # The mirror that this machine uses, and the way there.
  local mirror
  mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' | grep -v security | sort -u | sed -n 1p)
  debootstrap --variant=minbase --include=systemd,udev "$1" "$base" "$mirror" >"$CACHE/$1.log" 2>&1 ||
    { tail -5 "$CACHE/$1.log" >&2; fail "debootstrap of $1"; }
  cp -a /etc/apt/apt.conf.d/. "$base/etc/apt/apt.conf.d/"
  reach "$base"
  chroot "$base" sh -c "apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(echo $PACKAGES | tr , ' ')" \
    >"$CACHE/$1.log" 2>&1 || { tail -5 "$CACHE/$1.log" >&2; fail "the packages of the bare root of $1"; }
  chroot "$base" useradd --create-home --shell /bin/bash pilot
  echo 'pilot ALL=(ALL) NOPASSWD: ALL' >"$base/etc/sudoers.d/pilot"
  touch "$base/.complete"
}

# Where this machine's programs find certificates and mirrors, so that those inside reach the same.
WAYS=()
for name in SSL_CERT_FILE SSL_CERT_DIR CURL_CA_BUNDLE PIP_CERT REQUESTS_CA_BUNDLE NODE_EXTRA_CA_CERTS; do
  [ -z "${!name:-}" ] || WAYS+=("$name=${!name}")
done

reach() { # ROOT: names, certificates and mirrors as on this machine
  cp -L /etc/resolv.conf "$1/etc/"
  mkdir -p "$1/etc/ssl"
  cp -rL /etc/ssl/certs "$1/etc/ssl/" 2>/dev/null || true
  [ ! -f /etc/pip.conf ] || cp /etc/pip.conf "$1/etc/"
  [ ! -f ~/.npmrc ] || [ ! -d "$1/home/pilot" ] || install -m 600 -o "$(stat -c %u "$1/home/pilot")" ~/.npmrc "$1/home/pilot/.npmrc"
}

roots=()

# root NAME ADDRESS: a copy of the bare root. With an address, it is a machine of its own on the network 10.77.0.0/24 (see `network`).
root() {
  local name=$1 path
  path=$(mktemp -d -p "$CACHE" "run-$name-XXXXXX")
  cp -a "$base/." "$path/"
  reach "$path"
  mount -t proc proc "$path/proc"
  mount -t tmpfs -o mode=755 dev "$path/dev"
  mkdir "$path/dev/pts" "$path/dev/shm"
  mount -t devpts -o newinstance,ptmxmode=0666 devpts "$path/dev/pts"
  ln -s pts/ptmx "$path/dev/ptmx"
  ln -s /proc/self/fd "$path/dev/fd"
  ln -s /proc/self/fd/0 "$path/dev/stdin"
  ln -s /proc/self/fd/1 "$path/dev/stdout"
  ln -s /proc/self/fd/2 "$path/dev/stderr"
  local node
  for node in "null 1 3" "zero 1 5" "full 1 7" "random 1 8" "urandom 1 9" "tty 5 0"; do
    # shellcheck disable=SC2086 # three words
    set -- $node
    mknod -m 666 "$path/dev/$1" c "$2" "$3"
  done
  chmod 1777 "$path/dev/shm"
  echo "127.0.0.1 localhost $(hostname)" >"$path/etc/hosts"
  roots+=("$path")
  printf -v "root_$name" %s "$path"
}

# network NAME ADDRESS ...: from here on these roots are machines on one network, which reach each other and nothing else.
network() {
  local bridge=aeg$$ name address n=0
  ip link add "$bridge" type bridge
  ip link set "$bridge" up
  while [ $# -gt 0 ]; do
    name=$1 address=$2
    shift 2
    n=$((n + 1))
    ip netns add "aeg$$-$name"
    ip link add "aeg$$v$n" type veth peer name eth0 netns "aeg$$-$name"
    ip link set "aeg$$v$n" master "$bridge" up
    ip -n "aeg$$-$name" address add "$address/24" dev eth0
    ip -n "aeg$$-$name" link set eth0 up
    ip -n "aeg$$-$name" link set lo up
    printf -v "net_$name" %s "aeg$$-$name"
  done
}

# in_root NAME USER FOLDER SCRIPT: runs it there, as that user after a login.
in_root() {
  local path=root_$1 net=net_$1 user=$2 folder=$3 script=$4 enter=()
  path=${!path}
  [ -z "${!net:-}" ] || enter=(ip netns exec "${!net}")
  local ids home
  ids=$(chroot "$path" id -u "$user"):$(chroot "$path" id -g "$user")
  home=$(chroot "$path" getent passwd "$user" | cut -d : -f 6)
  "${enter[@]}" chroot "$path" setpriv --reuid "${ids%:*}" --regid "${ids#*:}" --init-groups \
    env -i HOME="$home" USER="$user" LOGNAME="$user" SHELL=/bin/bash LANG=C.UTF-8 PATH=/usr/local/bin:/usr/bin:/bin:/usr/local/sbin:/usr/sbin:/sbin \
    ${WAYS[@]+"${WAYS[@]}"} \
    bash -ec 'cd "$1"; eval "$2"' bash "$folder" "$script"
}

# Every process of the roots ends, and the roots are removed.
roots_end() {
  local status=$? path process
  for path in ${roots[@]+"${roots[@]}"}; do
    for process in /proc/[0-9]*; do
      case $(readlink "$process/root" 2>/dev/null) in "$path" | "$path"/*) kill -9 "${process##*/}" 2>/dev/null || true ;; esac
    done
  done
  for net in $(ip netns list 2>/dev/null | awk -v own="aeg$$-" 'index($1, own) == 1 { print $1 }'); do ip netns del "$net"; done
  ip link del "aeg$$" 2>/dev/null || true
  for path in ${roots[@]+"${roots[@]}"}; do
    if [ "$status" != 0 ] && [ "$keep" = yes ]; then
      say "kept: $path"
      continue
    fi
    umount -l "$path/dev/pts" "$path/dev" "$path/proc" 2>/dev/null || true
    rm -rf --one-file-system "$path"
  done
}

# checkout NAME: the committed project in the pilot's folder of that root
checkout() {
  local path=root_$1
  path=${!path}
  mkdir -p "$path$PILOT"
  git clone -q "$AERIE_ROOT" "$path$PILOT/aerie"
  chroot "$path" chown -R pilot:pilot /home/pilot
}

# received: bytes that this machine has received so far, by its way to others
received() { cat "/sys/class/net/$(ip route show default | sed -n 's/.* dev \([^ ]*\).*/\1/p' | head -1)/statistics/rx_bytes"; }

# until WHAT COMMAND ...: repeats it until it succeeds
until_ok() {
  local what=$1 end=$((SECONDS + PATIENCE))
  shift
  until "$@" >"$CACHE/last" 2>&1; do
    [ $SECONDS -lt $end ] || { cat "$CACHE/last" >&2; fail "$what: not within $PATIENCE s"; }
    sleep 1
  done
  cat "$CACHE/last"
}
