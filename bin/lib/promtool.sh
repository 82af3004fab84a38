# Prometheus' promtool, for the long tests of metrics, alerts and dashboard. Sourced by bin/test.
#
# The machine's own is used if there is one. Otherwise, on Debian and its relatives, it is downloaded from the suite that the toolchain is from
# (toolchain.sh), verified by apt against Debian's keys, and unpacked into .promtool/. The gateway itself does not use it.

AERIE_PROMTOOL_HOME=${AERIE_PROMTOOL_HOME:-$AERIE_ROOT/.promtool}

# Puts promtool on the PATH. Returns 1 after a warning that says what is missing and how to get it.
promtool_install() {
  have promtool && return 0
  have apt-get && have dpkg-deb || { warn "no promtool, and no apt-get to get it with. To fix it: install Prometheus"; return 1; }
  lock "$AERIE_PROMTOOL_HOME.lock" "another set-up is running here; waiting for it"
  local status=0
  [ -x "$AERIE_PROMTOOL_HOME/promtool" ] || (promtool_unpack "$AERIE_PROMTOOL_HOME.new") || status=1
  unlock
  [ $status = 0 ] || { warn "metrics and alerts are not tested with promtool: it could not be installed. To fix it: see above, or install Debian's package promtool"; return 1; }
  PATH=$AERIE_PROMTOOL_HOME:$PATH
}

promtool_unpack() {
  local work=$1 apt
  rm -rf "$work"
  toolchain_lists "$work" "$(dpkg --print-architecture)"
  step "promtool: downloading it (about 17 MB)"
  toolchain_fetch "$work" promtool
  dpkg-deb -x "$work"/debs/promtool_*.deb "$work/root"
  mv "$work/root/usr/bin/promtool" "$work/promtool"
  rm -rf "$work/root" "$work/debs" "$work/apt"
  "$work/promtool" --version >/dev/null 2>&1 ||
    fail "the unpacked promtool does not run" "this machine's libc is older than Debian 12's" "install Prometheus"
  step "promtool: $("$work/promtool" --version | sed -n '1s/.*version \([^ ]*\).*/\1/p')"
  rm -rf "$AERIE_PROMTOOL_HOME"
  mv "$work" "$AERIE_PROMTOOL_HOME"
}
