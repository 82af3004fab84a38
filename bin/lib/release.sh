# Makes a release of compiled code. Sourced by bin/release, which sets `output`.

# Called with the lock on compiling: Mix copies what it has compiled.
release_assemble() {
  step "assembling"
  rm -rf "$output/aerie"
  (cd "$AERIE_ROOT" && MIX_ENV=$1 mix release aerie --quiet --overwrite --path "$output/aerie") >&2 ||
    fail "mix release failed" "see above" "report the lines above"
}

# Adds nats-server and, from a private toolchain, the loader and the libraries, so that the machine's own libc does not matter.
# $1: the release's folder
release_runtime() {
  local release=$1 erts file name triplet loader libraries="$AERIE_TOOLCHAIN/usr/lib"
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
    cp "$(command -v nats-server)" "$release/bin/nats-server"
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
  cp "$AERIE_TOOLCHAIN/usr/sbin/nats-server.elf" "$release/bin/nats-server"
  toolchain_wrap_elf "$release/bin/nats-server" .. "$triplet" "$loader"

  # What programs and drivers are linked with, and what they load by name: resolvers of host names, SCTP for Erlang's sockets.
  {
    find "$release/erts-"* "$release/lib" "$release/bin" \( -name '*.elf' -o -name '*.so' \) -print0 |
      xargs -0 -n 1 "$libraries/$triplet/$loader" --library-path "$libraries/$triplet" --list |
      awk '$2 == "=>" && $3 ~ /^\// { print $3 }'
    ls "$libraries/$triplet"/lib{nss_dns,nss_files,resolv,sctp}.so.*
  } | sort -u | while read -r file; do
    case $file in
      "$libraries"/*) cp -L "$file" "$release/usr/lib/$triplet/${file##*/}" ;;
      *) fail "the toolchain lacks ${file##*/}" "a program of the release needs it" "add its package to bin/lib/toolchain.sh" ;;
    esac
  done
}

# Runs it without this machine's environment, and has it write its own man page and completion.
release_check() {
  mkdir -p "$1/share/man/man1" "$1/share/bash-completion/completions"
  env -i "$1/bin/aerie" eval ':crypto.hash(:sha256, "x"); {:ok, _} = Application.ensure_all_started(:fast_yaml); :ok' >/dev/null ||
    fail "the release does not run" "see above" "report the lines above; $1 is kept"
  env -i "$1/bin/aerie" man >"$1/share/man/man1/aerie.1"
  env -i "$1/bin/aerie" completion >"$1/share/bash-completion/completions/aerie"
  env -i "$1/bin/nats-server" --version >/dev/null || fail "its nats-server does not run" "see above" "report the lines above"
  [ -e "$1"/lib/circuits_uart-*/priv/circuits_uart ] ||
    warn "the release cannot open serial ports, because it was made without a C compiler. To fix it: apt-get install gcc libc6-dev"
}

release_pack() {
  local name file
  # The file has no end of line.
  read -r _ name <"$1/aerie/releases/start_erl.data" || true
  name=aerie-$name-linux-$(uname -m)
  file=$name.tar.gz
  step "packing"
  # The same content gives the same bytes.
  tar -C "$1" --transform "s,^aerie,$name," --sort=name --owner=0 --group=0 --numeric-owner --mtime="@${SOURCE_DATE_EPOCH:-0}" -cf - aerie |
    gzip -n -9 >"$1/$file.new"
  mv "$1/$file.new" "$1/$file"
  (cd "$1" && sha256sum "$file" >"$file.sha256")
  step "made $1/$file ($(du -m "$1/$file" | cut -f 1) MB, unpacked $(du -sm "$1/aerie" | cut -f 1) MB)"
}
