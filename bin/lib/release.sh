# Makes a release of compiled code. Sourced by bin/release, which sets `output`, and calls `release_for` first.

# What Debian calls this machine's architecture, if it is one of those that releases are made for; else what the kernel calls it.
release_own() {
  case $(uname -m) in
    x86_64) echo amd64 ;;
    aarch64) echo arm64 ;;
    *) uname -m ;;
  esac
}

# release_for ARCHITECTURE: sets `architecture`, `machine` (the kernel's name of it), `runtime` (the toolchain whose programs and libraries
# the release gets) and `foreign` (whether it is another one than the machine's; Mix then compiles into a folder of its own, by MIX_TARGET).
release_for() {
  architecture=$1 runtime=$AERIE_TOOLCHAIN foreign=no
  case $architecture in
    amd64) machine=x86_64 ;;
    arm64) machine=aarch64 ;;
    *) machine=$architecture ;;
  esac
  [ "$architecture" != "$(release_own)" ] || return 0
  cross_install "$architecture"
  foreign=yes runtime=$AERIE_CROSS
  export MIX_TARGET=$architecture
  export CC="$AERIE_CROSS/compiler/usr/bin/$machine-linux-gnu-gcc"
  AERIE_ERTS=$(echo "$AERIE_CROSS"/usr/lib/erlang/erts-*)
  export AERIE_ERTS
}

# Called with the lock on compiling. Compiled Elixir is the same on all machines: another architecture's release begins
# with this machine's, so that only what is written in C is compiled for it.
release_share() {
  local build="$AERIE_ROOT/_build"
  rm -rf "$build/${architecture}_$1"
  cp -a "$build/$1" "$build/${architecture}_$1" ||
    fail "the compiled code could not be copied" "see above" "make room on the disk and run this again"
}

# Called with the lock on compiling: Mix copies what it has compiled.
release_assemble() {
  step "assembling"
  rm -rf "$output/aerie"
  together mix_release "$1" >&2 || fail "mix release failed" "see above" "report the lines above"
}
mix_release() { cd "$AERIE_ROOT" && MIX_ENV=$1 mix release aerie --quiet --overwrite --path "$output/aerie"; }

# Adds nats-server, xz and, from a private toolchain, the loader and the libraries, so that the machine's own libc does not matter.
# $1: the release's folder
release_runtime() {
  local release=$1 erts file name triplet loader libraries="$runtime/usr/lib"
  erts=$(echo "$release"/erts-*)
  # No gateway uses them.
  for name in dialyzer typer erlc escript ct_run epmd yielding_c_fun to_erl start start_erl erl_call; do
    rm -f "$erts/bin/$name" "$erts/bin/$name.elf"
  done
  rm -rf "$erts"/{include,src,doc,man}
  # Mix's own way in, with a cookie that everybody who has the tarball would know.
  rm -f "$release/releases/COOKIE" "$release"/releases/*/remote.vm.args
  mkdir -p "$release/bin"
  if [ ! -x "$AERIE_TOOLCHAIN/bin/elixir" ]; then
    warn "Erlang is this machine's own, so the release needs this machine's libraries. To fix it: make it where bin/setup installs a toolchain"
    cp "$(command -v nats-server)" "$(command -v xz)" "$release/bin/"
    return
  fi

  triplet=$(basename "$(dirname "$(ls -d "$libraries"/*-linux-gnu/libc.so.6)")")
  loader=$(basename "$(ls "$libraries/$triplet"/ld-linux-*.so.*)")
  mkdir -p "$release/usr/lib/$triplet"
  cp -L "$libraries/$triplet/$loader" "$release/usr/lib/$triplet/"
  for file in "$erts"/bin/*.elf; do
    mv "$file" "${file%.elf}"
    toolchain_wrap_elf "${file%.elf}" ../.. "$triplet" "$loader"
  done
  for file in usr/sbin/nats-server usr/bin/xz; do
    name=$release/bin/${file##*/}
    cp "$runtime/$file.elf" "$name"
    toolchain_wrap_elf "$name" .. "$triplet" "$loader"
  done

  # What programs and drivers are linked with, and what they load by name: resolvers of host names, SCTP for Erlang's sockets.
  # shellcheck disable=SC2046 # a list of words on purpose
  elixir "$AERIE_ROOT/bin/lib/libraries.exs" "$release" "$libraries/$triplet" \
    $(cd "$libraries/$triplet" && ls lib{nss_dns,nss_files,resolv,sctp}.so.*) ||
    fail "the libraries are not those of the programs" "see above" "add a missing one's package to bin/lib/toolchain.sh"
}

# $1: the release's folder
release_sbom() {
  if [ -e "$runtime/packages/index" ]; then
    (toolchain_licences "$runtime" "$architecture") || warn "the release lacks the licences of what is linked into nats-server. To fix it: see above"
  fi
  AERIE_TOOLCHAIN=$runtime elixir "$AERIE_ROOT/bin/lib/sbom.exs" "$1" || fail "no list of what the release contains" "see above" "report the lines above"
}

# release_aerie RELEASE WORD ...: its bin/aerie, without this machine's environment. The code of another architecture's release is the
# same, so it runs on the machine's Erlang.
release_aerie() {
  local release=$1 version
  shift
  if [ "$foreign" = no ]; then
    env -i "$release/bin/aerie" "$@"
    return
  fi
  read -r _ version <"$release/releases/start_erl.data" || true
  env -i PATH="$PATH" erl -boot "$release/releases/$version/start_clean" -boot_var RELEASE_LIB "$release/lib" \
    -config "$release/releases/$version/sys" -args_file "$release/releases/$version/vm.args" \
    +Bd -noshell -eval "'Elixir.Aerie.CLI':main()" -extra "$@"
}

# Runs it, and has it write its own man page and completion.
release_check() {
  local name
  mkdir -p "$1/share/man/man1" "$1/share/bash-completion/completions"
  release_aerie "$1" man >"$1/share/man/man1/aerie.1" || fail "the release does not run" "see above" "report the lines above; $1 is kept"
  release_aerie "$1" completion >"$1/share/bash-completion/completions/aerie"
  if [ "$foreign" = no ]; then
    release_aerie "$1" eval ':crypto.hash(:sha256, "x"); {:ok, _} = Application.ensure_all_started(:fast_yaml); :ok' >/dev/null ||
      fail "the release does not run" "see above" "report the lines above; $1 is kept"
    for name in nats-server xz; do
      env -i "$1/bin/$name" --version >/dev/null || fail "its $name does not run" "see above" "report the lines above"
    done
  fi
  [ -e "$1"/lib/circuits_uart-*/priv/circuits_uart ] ||
    warn "the release cannot open serial ports, because it was made without a C compiler. To fix it: apt-get install gcc libc6-dev"
}

release_pack() {
  local name file
  # The file has no end of line.
  read -r _ name <"$1/aerie/releases/start_erl.data" || true
  name=aerie-$name-linux-$machine
  file=$name.tar.gz
  step "packing"
  # The same content gives the same bytes.
  tar -C "$1" --transform "s,^aerie,$name," --sort=name --owner=0 --group=0 --numeric-owner --mtime="@${SOURCE_DATE_EPOCH:-0}" -cf - aerie |
    gzip -n -9 >"$1/$file.new"
  mv "$1/$file.new" "$1/$file"
  (cd "$1" && sha256sum "$file" >"$file.sha256")
  step "made $1/$file ($(du -m "$1/$file" | cut -f 1) MB, unpacked $(du -sm "$1/aerie" | cut -f 1) MB)"
}
