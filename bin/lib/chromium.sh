# A browser for the tests of the pages. Sourced by bin/setup and bin/test.
#
# The machine's own Chromium or Chrome is used if there is one. Otherwise, on Debian and its relatives, Chromium and the
# libraries that this machine lacks are downloaded from its own apt sources, verified by apt, and unpacked into .chromium/.

. "$AERIE_ROOT/bin/lib/download.sh"

AERIE_CHROMIUM_HOME=${AERIE_CHROMIUM_HOME:-$AERIE_ROOT/.chromium}

chromium_find() {
  local name
  for name in chromium chromium-browser google-chrome google-chrome-stable; do
    command -v "$name" && return 0
  done
  [ -x "$AERIE_CHROMIUM_HOME/chromium" ] && printf '%s\n' "$AERIE_CHROMIUM_HOME/chromium"
}

# Sets AERIE_CHROMIUM. Returns 1 after a warning that says what is missing and how to get it.
chromium_install() {
  if AERIE_CHROMIUM=$(chromium_find); then
    export AERIE_CHROMIUM
    return 0
  fi
  unset AERIE_CHROMIUM
  have apt-get && have dpkg-deb || { warn "no browser, and no apt-get to get Chromium with. To fix it: install Chromium"; return 1; }
  lock "$AERIE_CHROMIUM_HOME.lock" "another set-up is running here; waiting for it"
  local status=0
  [ -x "$AERIE_CHROMIUM_HOME/chromium" ] || together chromium_unpack "$AERIE_CHROMIUM_HOME.new" || status=1
  unlock
  [ $status = 0 ] || return 1
  AERIE_CHROMIUM=$AERIE_CHROMIUM_HOME/chromium
  export AERIE_CHROMIUM
}

chromium_unpack() {
  local work=$1 log="$1/log" apt deb packages why cure
  rm -rf "$work"
  mkdir -p "$work/apt/lists/partial" "$work/apt/archives/partial" "$work/debs"
  apt=(-q -o "Dir::State::lists=$work/apt/lists" -o "Dir::Cache=$work/apt" -o Debug::NoLocking=1 -o Acquire::Languages=none
    -o "Acquire::IndexTargets::deb::DEP-11::DefaultEnabled=false" -o Acquire::Retries=3 -o "APT::Sandbox::User=$(id -un)")
  step "chromium: downloading it and the libraries that are missing (about 125 MB)"
  if ! apt-get "${apt[@]}" -o APT::Update::Error-Mode=any update >"$log" 2>&1 ||
    ! packages=$(apt-get "${apt[@]}" -y --no-install-recommends --print-uris install chromium fonts-dejavu-core 2>>"$log" |
      awk '/^\047/ { sub(/_.*/, "", $2); print $2 }') ||
    # shellcheck disable=SC2086 # a list of words on purpose
    ! (cd "$work/debs" && apt-get "${apt[@]}" download $packages >>"$log" 2>&1); then
    tail -n 3 "$log" >&2
    download_fault "$log"
    warn "Chromium could not be downloaded ($why; the output is in $log). To fix it: $cure; or install Chromium"
    return 1
  fi
  for deb in "$work"/debs/*.deb; do dpkg-deb -x "$deb" "$work"; done
  rm -rf "$work/debs" "$work/apt" "$work/usr/share/doc" "$work/usr/share/man" "$work/usr/share/locale"
  cat >"$work/fonts.conf" <<'FONTS'
<?xml version="1.0"?>
<!DOCTYPE fontconfig SYSTEM "fonts.dtd">
<fontconfig><dir prefix="relative">usr/share/fonts</dir><dir>/usr/share/fonts</dir><cachedir prefix="xdg">fontconfig</cachedir></fontconfig>
FONTS
  cat >"$work/chromium" <<'WRAPPER'
#!/bin/sh
d=$(cd "${0%/*}" && pwd -P)
# A package may have its libraries in /lib.
libraries=$(find "$d/usr/lib" "$d/lib" -name '*.so*' -not -path '*/chromium/*' -printf '%h\n' 2>/dev/null | sort -u | tr '\n' ':')
XDG_CACHE_HOME=$d/cache LD_LIBRARY_PATH=$libraries$d/usr/lib/chromium FONTCONFIG_FILE=$d/fonts.conf exec "$d/usr/lib/chromium/chromium" "$@"
WRAPPER
  chmod 755 "$work/chromium"
  if ! "$work/chromium" --version >"$log" 2>&1; then
    tail -n 3 "$log" >&2
    warn "the unpacked Chromium does not run (the output is in $log). To fix it: install Chromium"
    return 1
  fi
  step "chromium: $(cat "$log")"
  rm -f "$log"
  rm -rf "$AERIE_CHROMIUM_HOME"
  mv "$work" "$AERIE_CHROMIUM_HOME"
}
