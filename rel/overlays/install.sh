#!/bin/sh
# Installs the unpacked release as a systemd service, or removes it. See --help.
set -eu
self=$(readlink -f "$0")
here=${self%/*}

usage() {
  cat <<'TEXT'
usage: ./install.sh [--no-start]      installs or upgrades, as root
       ./install.sh --uninstall       removes the program; configuration and data stay
       ./install.sh --stage FOLDER    only copies the files below FOLDER; --configure does the rest: for a package

  /opt/aerie                     the program, replaced by an upgrade
  /etc/aerie/gateway.yaml        the configuration, made once from gateway.example.yaml
  /etc/aerie/environment         keys and passwords as AERIE_…=VALUE, for root only; made by you
  /var/lib/aerie                 what the gateway keeps: outbox, ledger, recordings, NATS, keys
  aerie.service, 60-aerie.rules  for systemd and udev
  /usr/bin/aerie                 the command, with its man page and completion
  user and group aerie           the gateway runs as; member of dialout, for serial ports

  An upgrade keeps configuration and data, and restarts a gateway that runs: what it keeps on the disk is read by the new version.
TEXT
}

fail() {
  printf 'error: %s\n' "$*" >&2
  exit 1
}

# stage ROOT: the program and the files of systemd and udev, below ROOT (empty: this machine)
stage() {
  [ -e "$here/releases/start_erl.data" ] || fail "$here is not a release: unpack aerie-VERSION-linux-ARCHITECTURE.tar.gz, and call its install.sh"
  mkdir -p "$1/opt" "$1/usr/bin" "$1/usr/share/man/man1" "$1/usr/share/bash-completion/completions" "$1/lib/systemd/system" "$1/lib/udev/rules.d" "$1/etc/aerie"
  rm -rf "$1/opt/aerie.new"
  mkdir "$1/opt/aerie.new"
  # What a gateway has left that was started from here stays here.
  (cd "$here" && tar -cf - --exclude=./var .) | tar -C "$1/opt/aerie.new" -xf - --no-same-owner
  chmod -R u=rwX,go=rX "$1/opt/aerie.new"
  rm -rf "$1/opt/aerie.old"
  [ ! -e "$1/opt/aerie" ] || mv "$1/opt/aerie" "$1/opt/aerie.old"
  mv "$1/opt/aerie.new" "$1/opt/aerie"
  rm -rf "$1/opt/aerie.old"
  ln -sfn /opt/aerie/bin/aerie "$1/usr/bin/aerie"
  ln -sfn /opt/aerie/share/man/man1/aerie.1 "$1/usr/share/man/man1/aerie.1"
  ln -sfn /opt/aerie/share/bash-completion/completions/aerie "$1/usr/share/bash-completion/completions/aerie"
  install -m 644 "$here/systemd/aerie.service" "$1/lib/systemd/system/aerie.service"
  install -m 644 "$here/udev/60-aerie.rules" "$1/lib/udev/rules.d/60-aerie.rules"
}

# What a package's scripts do as well: the user, the configuration, the folder of data.
prepare() {
  getent group aerie >/dev/null || groupadd --system aerie
  getent passwd aerie >/dev/null ||
    useradd --system --gid aerie --home-dir /var/lib/aerie --no-create-home --shell /usr/sbin/nologin aerie
  ! getent group dialout >/dev/null || usermod -a -G dialout aerie
  [ -e /etc/aerie/gateway.yaml ] || install -m 640 -g aerie /opt/aerie/gateway.example.yaml /etc/aerie/gateway.yaml
  # 0750: the gateway reads it, others do not.
  chgrp aerie /etc/aerie
  chmod 750 /etc/aerie
  install -d -m 700 -o aerie -g aerie /var/lib/aerie
}

reload() {
  if [ -d /run/systemd/system ]; then systemctl daemon-reload; fi
  if [ -d /run/udev ]; then udevadm control --reload && udevadm trigger --subsystem-match=tty || true; fi
}

start() {
  if [ -d /run/systemd/system ]; then
    systemctl enable aerie.service
    systemctl restart aerie.service
    echo "aerie runs: systemctl status aerie, journalctl -u aerie; its console: http://127.0.0.1:4000/"
  else
    echo "installed; no systemd runs here. To start the gateway: AERIE_HOME=/var/lib/aerie aerie start"
  fi
}

uninstall() {
  if [ -d /run/systemd/system ]; then systemctl disable --now aerie.service || true; fi
  rm -rf /opt/aerie /opt/aerie.new /opt/aerie.old
  rm -f /usr/bin/aerie /usr/share/man/man1/aerie.1 /usr/share/bash-completion/completions/aerie /lib/systemd/system/aerie.service /lib/udev/rules.d/60-aerie.rules
  reload
  echo "removed; /etc/aerie and /var/lib/aerie stay. To remove them, and the user: rm -r /etc/aerie /var/lib/aerie; userdel aerie"
}

start=yes
case ${1:-} in
  -h | --help) usage; exit 0 ;;
  --stage) [ $# = 2 ] || { usage >&2; exit 2; }; stage "$2"; exit 0 ;;
  --no-start) start=no ;;
  --uninstall | --configure | '') ;;
  *) usage >&2; exit 2 ;;
esac
[ "$(id -u)" = 0 ] || fail "only root can install a service: sudo ./install.sh"
if [ "${1:-}" = --uninstall ]; then uninstall; exit 0; fi
[ "${1:-}" = --configure ] || stage ""
prepare
reload
if [ "$start" = yes ]; then start; fi
