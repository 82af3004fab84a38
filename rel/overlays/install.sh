#!/bin/sh
# Installs the unpacked release as a systemd service, or removes it. See --help.
set -eu
umask 022
self=$(readlink -f "$0")
here=${self%/*}

usage() {
  cat <<'TEXT'
usage: ./install.sh [--no-start]      installs or upgrades, as root
       ./install.sh --upgrade [--now] the same, for aerie upgrade
       ./install.sh --uninstall       removes the program; configuration and data stay
       ./install.sh --prepare         only makes the user, the configuration and the folder of data: for an image
       ./install.sh --stage FOLDER    only copies the files below FOLDER; --configure does the rest: for a package

  /opt/aerie                     the program: a link to a version in /opt/aerie-versions
  /etc/aerie/gateway.yaml        the configuration, made once from gateway.example.yaml
  /etc/aerie/environment         keys and passwords as AERIE_…=VALUE, for root only; made by you
  /var/lib/aerie                 what the gateway keeps: outbox, ledger, recordings, NATS, keys
  aerie.service, 60-aerie.rules  for systemd and udev
  /usr/bin/aerie                 the command, with its man page and completion
  user and group aerie           the gateway runs as; member of dialout, for serial ports

  An upgrade keeps configuration and data. A gateway that runs hands over to the new version, or goes on if something would be lost
  (aerie upgrade --help).
TEXT
}

fail() {
  printf 'error: %s\n' "$*" >&2
  exit 1
}

# files ROOT: what is not of one version: links, and the files of systemd and udev, below ROOT (empty: this machine)
files() {
  mkdir -p "$1/usr/bin" "$1/usr/share/man/man1" "$1/usr/share/bash-completion/completions" "$1/lib/systemd/system" "$1/lib/udev/rules.d" "$1/etc/aerie"
  ln -sfn /opt/aerie/bin/aerie "$1/usr/bin/aerie"
  ln -sfn /opt/aerie/share/man/man1/aerie.1 "$1/usr/share/man/man1/aerie.1"
  ln -sfn /opt/aerie/share/bash-completion/completions/aerie "$1/usr/share/bash-completion/completions/aerie"
  install -m 644 "$here/systemd/aerie.service" "$1/lib/systemd/system/aerie.service"
  install -m 644 "$here/udev/60-aerie.rules" "$1/lib/udev/rules.d/60-aerie.rules"
}

is_release() { [ -e "$here/releases/start_erl.data" ] || fail "$here is not a release: unpack aerie-VERSION-linux-ARCHITECTURE.tar.gz, and call its install.sh"; }

# copy FOLDER: the release, without what a gateway has left that was started from here
copy() {
  rm -rf "$1"
  mkdir -p "$1"
  # A package's files are linked, which takes no room; dpkg puts others in their place and leaves these alone.
  if [ "$here" != $packaged ] || ! cp -al "$here/." "$1/" 2>/dev/null; then
    (cd "$here" && tar -cf - --exclude=./var .) | tar -C "$1" -xf - --no-same-owner
  fi
  [ "$here" = $packaged ] || chmod -R u=rwX,go=rX "$1"
}

# version: the folder of this release among the versions, by its content
version() {
  read -r _ number <"$here/releases/start_erl.data" || true
  printf '%s/%s-%s' $versions "$number" "$(cd "$here" && find . -path ./var -prune -o -type f -print | LC_ALL=C sort | xargs -d '\n' sha256sum | sha256sum | cut -c 1-8)"
}

# place: puts this release among the versions
place() {
  is_release
  own=$(version)
  if [ ! -d "$own" ]; then
    copy $versions/.new
    mv $versions/.new "$own"
  fi
  # A machine from before there were versions.
  [ ! -d /opt/aerie ] || [ -L /opt/aerie ] || mv /opt/aerie $versions/0-unknown
  [ -L /opt/aerie ] || ln -sfn "aerie-versions/${own##*/}" /opt/aerie
}

# What a package's scripts do as well: the user, the configuration, the folder of data.
prepare() {
  getent group aerie >/dev/null || groupadd --system aerie
  getent passwd aerie >/dev/null ||
    useradd --system --gid aerie --home-dir /var/lib/aerie --no-create-home --shell /usr/sbin/nologin aerie
  ! getent group dialout >/dev/null || usermod -a -G dialout aerie
  [ -e /etc/aerie/gateway.yaml ] || install -m 640 -g aerie "$here/gateway.example.yaml" /etc/aerie/gateway.yaml
  # 0750: the gateway reads it, others do not.
  chgrp aerie /etc/aerie
  chmod 750 /etc/aerie
  install -d -m 700 -o aerie -g aerie /var/lib/aerie
}

reload() {
  if [ -d /run/systemd/system ]; then systemctl daemon-reload; fi
  if [ -d /run/udev ]; then udevadm control --reload && udevadm trigger --subsystem-match=tty || true; fi
}

# start: has the version that was placed take over from the gateway that runs, or starts it
start() {
  if [ -d /run/systemd/system ]; then systemctl enable aerie.service; fi
  if [ -d /run/systemd/system ] && ! systemctl is-active --quiet aerie.service; then
    ln -sfn "aerie-versions/${own##*/}" /opt/aerie
    systemctl restart aerie.service
    echo "aerie runs: systemctl status aerie, journalctl -u aerie; its console: http://127.0.0.1:4000/"
    return 0
  fi
  [ "$(readlink -f /opt/aerie)" = "$own" ] || ln -sfn "${own##*/}" $versions/next
  status=0
  "$own/bin/aerie" upgrade --take-over $now || status=$?
  runs=0
  "$own/bin/aerie" status >/dev/null 2>&1 || runs=$?
  if [ $status = 0 ] && [ $runs = 3 ]; then
    echo "installed; no systemd runs here. To start the gateway: AERIE_HOME=/var/lib/aerie aerie start"
  elif [ $status != 0 ]; then
    echo "the earlier version stays in force; ${own##*/} is installed: sudo aerie upgrade puts it in its place"
  fi
  return $status
}

uninstall() {
  if [ -d /run/systemd/system ]; then systemctl disable --now aerie.service || true; fi
  rm -rf /opt/aerie $versions
  rm -f /usr/bin/aerie /usr/share/man/man1/aerie.1 /usr/share/bash-completion/completions/aerie /lib/systemd/system/aerie.service /lib/udev/rules.d/60-aerie.rules
  reload
  echo "removed; /etc/aerie and /var/lib/aerie stay. To remove them, and the user: rm -r /etc/aerie /var/lib/aerie; userdel aerie"
}

versions=/opt/aerie-versions
# Where a package has the release.
packaged=/usr/lib/aerie
start=yes now=
case ${1:-} in
  -h | --help) usage; exit 0 ;;
  --stage)
    [ $# = 2 ] || { usage >&2; exit 2; }
    is_release
    files "$2"
    copy "$2$packaged"
    exit 0
    ;;
  --no-start) start=no ;;
  --upgrade) case ${2:-} in '' | --now) now=${2:-} ;; *) usage >&2; exit 2 ;; esac ;;
  --uninstall | --prepare | --configure | '') ;;
  *) usage >&2; exit 2 ;;
esac
[ "$(id -u)" = 0 ] || fail "only root can install a service: sudo ./install.sh"
if [ "${1:-}" = --uninstall ]; then uninstall; exit 0; fi
if [ "${1:-}" = --prepare ]; then prepare; exit 0; fi
place
[ "${1:-}" = --configure ] || files ""
prepare
reload
if [ "$start" = no ]; then ln -sfn "aerie-versions/${own##*/}" /opt/aerie; exit 0; fi
# The package is installed, whichever version runs.
if [ "${1:-}" = --configure ]; then start || true; else start; fi
