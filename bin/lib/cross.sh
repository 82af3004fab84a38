# The toolchain of another architecture, for bin/release --arch. Sourced by bin/release and bin/test.
#
# .toolchain-ARCHITECTURE/ has the same Debian packages for that architecture, unpacked and wrapped like the machine's own (toolchain.sh).
# Nothing of it runs here: compiled Elixir is the same on all machines, so the machine's Mix makes the release of it. compiler/ in it is
# Debian's cross compiler for the program of serial ports; that one runs here, by wrappers of the same kind.

CROSS_REVISION=1 # increase it if the steps below change

# cross_install ARCHITECTURE: installs it, and sets AERIE_CROSS to its folder.
cross_install() {
  local architecture=$1 stamp otp status
  AERIE_CROSS=$AERIE_TOOLCHAIN-$architecture
  export AERIE_CROSS
  [ -x "$AERIE_TOOLCHAIN/bin/elixir" ] || fail "no release for $architecture can be made here" \
    "Erlang is this machine's own, and only for Debian's packages there are the same ones for $architecture" "make it on a machine of that architecture"
  otp=$(cross_otp "$AERIE_TOOLCHAIN")
  stamp="$CROSS_REVISION $TOOLCHAIN_REVISION $TOOLCHAIN_SUITE $architecture $otp"
  lock "$AERIE_CROSS.lock" "another set-up is running here; waiting for it"
  if [ "$(cat "$AERIE_CROSS/.complete" 2>/dev/null)" != "$stamp" ]; then
    [ ! -d "$AERIE_CROSS" ] || unused "$AERIE_CROSS" || fail "$AERIE_CROSS is outdated" "it cannot be replaced while a release is made of it" "wait, then run this again"
    together cross_make "$architecture" "$otp" "$stamp"
    # Not reached unless the caller goes on without it.
    status=$?
    [ $status = 0 ] || { unlock; return $status; }
  fi
  hold "$AERIE_CROSS"
  unlock
}

cross_make() {
  local architecture=$1 otp=$2 stamp=$3 work=$AERIE_CROSS.new
  rm -rf "$work"
  toolchain_download "$work" "$architecture"
  toolchain_unpack "$work"
  # The boot script names OTP's applications with their versions, and the code is compiled and tested with those of this machine.
  [ "$(cross_otp "$work")" = "$otp" ] || fail "Debian has OTP $(cross_otp "$work") for $architecture, and .toolchain/ has $otp" \
    "Debian $TOOLCHAIN_SUITE has moved on" "remove $AERIE_TOOLCHAIN and run this again; if that does not help, $architecture is behind: try again in a few days"
  toolchain_wrap "$work"
  cross_compiler "$work/compiler" "$architecture"
  printf '%s' "$stamp" >"$work/.complete"
  rm -rf "$AERIE_CROSS"
  mv "$work" "$AERIE_CROSS"
}

cross_otp() { cat "$1"/usr/lib/erlang/releases/*/OTP_VERSION; }

# cross_compiler WORK ARCHITECTURE: a C compiler and libc for it, in WORK
cross_compiler() {
  local work=$1 architecture=$2 target packages apt deb triplet loader file name
  mkdir -p "$work"
  case $architecture in
    amd64) target=x86_64-linux-gnu ;;
    arm64) target=aarch64-linux-gnu ;;
  esac
  toolchain_lists "$work" "$(dpkg --print-architecture)"
  step "toolchain: downloading a C compiler for $architecture (about 60 MB)"
  # All that they depend on: nothing of the machine's own is used.
  packages=$(apt-get "${apt[@]}" -y --no-install-recommends --print-uris install "gcc-${target//_/-}" "libc6-dev-$architecture-cross" 2>"$work/apt/log" |
    awk '/^\047/ { sub(/_.*/, "", $2); print $2 }') ||
    { tail -n 3 "$work/apt/log" >&2; fail "no C compiler for $architecture" "see above" "run this again"; }
  # shellcheck disable=SC2086 # a list of words on purpose
  toolchain_fetch "$work" $packages
  for deb in "$work"/debs/*.deb; do dpkg-deb -x "$deb" "$work"; done
  rm -rf "$work/debs" "$work/apt" "$work/usr/share"

  triplet=$(basename "$(dirname "$(ls -d "$work"/usr/lib/*-linux-gnu/libc.so.6)")")
  loader=$(basename "$(ls "$work/usr/lib/$triplet"/ld-linux-*.so.*)")
  for file in "$work/usr/bin/$target"-*; do
    if is_elf "$file"; then toolchain_wrap_elf "$file" ../.. "$triplet" "$loader"; fi
  done
  for file in "$work/usr/libexec/gcc-cross/$target"/*/*; do
    case $file in *.so) continue ;; esac
    if is_elf "$file"; then toolchain_wrap_elf "$file" ../../../../.. "$triplet" "$loader"; fi
  done
  # These are links, and a wrapper finds its program beside the name that it is called by.
  for name in as ld; do
    rm -f "$work/usr/$target/bin/$name"
    toolchain_forward "$work/usr/$target" "$name" "../bin/$target-$name"
  done
  printf '#include <stdio.h>\nint main(void) { return puts("") < 0; }\n' >"$work/check.c"
  "$work/usr/bin/$target-gcc" -static -o "$work/check" "$work/check.c" 2>"$work/check.log" ||
    { tail -n 5 "$work/check.log" >&2; fail "the unpacked C compiler for $architecture does not run" "see above" "report it with the lines above; $work is kept"; }
  rm -f "$work"/check*
}
