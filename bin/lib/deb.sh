# Makes a Debian package of an unpacked release. Sourced by bin/release.

# release_deb FOLDER: FOLDER/aerie is the release for `architecture`; the package stands beside it.
release_deb() {
  local folder=$1 version stage deb
  have dpkg-deb || fail "no dpkg-deb" "it makes the package" "apt-get install dpkg"
  read -r _ version <"$folder/aerie/releases/start_erl.data" || true
  case $architecture in
    amd64 | arm64) ;;
    *) fail "no Debian architecture for $architecture" "" "make the package for amd64 or arm64" ;;
  esac
  stage=$folder/deb
  deb=$folder/aerie_${version}_$architecture.deb
  step "making the Debian package"
  rm -rf "$stage"
  "$folder/aerie/install.sh" --stage "$stage"
  mkdir -p "$stage/DEBIAN" "$stage/usr/share/doc/aerie"
  {
    printf 'Aerie is under the licence below. What the package brings along: /usr/lib/aerie/sbom.cdx.json and /usr/lib/aerie/licences.\n\n'
    cat "$AERIE_ROOT/LICENSE"
  } >"$stage/usr/share/doc/aerie/copyright"
  cat >"$stage/DEBIAN/control" <<TEXT
Package: aerie
Version: $version
Architecture: $architecture
Section: net
Priority: optional
Maintainer: The Aerie project <aerie@localhost>
Installed-Size: $(du -sk "$stage" | cut -f 1)
Depends: passwd, libc-bin
Recommends: systemd, udev
Description: gateway between MAVLink vehicles and a NATS fleet
 Aerie connects drones and other vehicles (ArduPilot, PX4) to a NATS fleet, to
 ground stations and to a console in the browser. The package brings its own
 Erlang runtime, libraries, nats-server and xz.
TEXT
  # The same steps as install.sh, which is in the package.
  deb_script "$stage" postinst configure '/usr/lib/aerie/install.sh --configure'
  deb_script "$stage" prerm remove 'if [ -d /run/systemd/system ]; then systemctl disable --now aerie.service || true; fi'
  deb_script "$stage" postrm 'remove|purge' 'rm -rf /opt/aerie /opt/aerie-versions
    [ "$1" = purge ] || exit 0
    rm -rf /etc/aerie /var/lib/aerie; ! getent passwd aerie >/dev/null || userdel aerie'
  find "$stage" -type d -exec chmod 755 {} +
  dpkg-deb -Zgzip --root-owner-group --build "$stage" "$deb" >&2
  rm -rf "$stage"
  step "made $deb ($(du -m "$deb" | cut -f 1) MB)"
}

# deb_script STAGE NAME WHEN COMMAND: a script of the package that runs COMMAND when dpkg calls it with WHEN (or one of several, with |)
deb_script() {
  printf '#!/bin/sh\nset -e\ncase ${1:-} in\n  %s) %s ;;\nesac\n' "$3" "$4" >"$1/DEBIAN/$2"
  chmod 755 "$1/DEBIAN/$2"
}
