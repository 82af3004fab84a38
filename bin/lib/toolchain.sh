# Elixir, OTP, nats-server and xz, without root and inside the checkout. Sourced by the scripts that need them.
#
# The machine's own Elixir is used if it is new enough and has the libraries. Otherwise, on Debian and its relatives, the
# packages of Debian's forky suite are downloaded with a private apt configuration, verified by apt against Debian's
# keys, and unpacked into .toolchain/. A wrapper starts each ELF program there through the unpacked loader and libc, so that
# an older system's libc does not matter. Its paths are relative, so that the folder can be moved.

. "$AERIE_ROOT/bin/lib/download.sh"

TOOLCHAIN_SUITE=forky
TOOLCHAIN_REVISION=7 # increase it if the steps below change: older set-ups are then made again

toolchain_packages() {
  cat <<'LIST'
elixir elixir-ex-doc elixir-earmark-parser elixir-makeup elixir-makeup-elixir elixir-makeup-erlang
elixir-nimble-parsec
erlang-base erlang-crypto erlang-mnesia erlang-asn1 erlang-public-key erlang-runtime-tools erlang-ssl erlang-inets
erlang-parsetools erlang-tools erlang-syntax-tools erlang-xmerl erlang-dialyzer erlang-os-mon erlang-eunit
erlang-ranch erlang-cowlib erlang-cowboy erlang-p1-utils erlang-p1-yaml erlang-proper
nats-server xz-utils
libc6 libatomic1 libgcc-s1 libstdc++6 libtinfo6 libsctp1 libsystemd0 zlib1g libzstd1 liblzma5 libssl3t64 libyaml-0-2
LIST
}

TOOLCHAIN_NEEDS="Elixir >= $AERIE_MIN_ELIXIR on OTP >= $AERIE_MIN_OTP with cowboy, proper and fast_yaml, nats-server, and xz"

# True if the Elixir on PATH is new enough and has the libraries that Aerie otherwise takes from Debian.
toolchain_system_ok() {
  have elixir && have erl && have nats-server && have xz || return 1
  elixir -e '
    ok = Version.match?(System.version(), ">= '"$AERIE_MIN_ELIXIR"'") and
      String.to_integer(System.otp_release()) >= '"$AERIE_MIN_OTP"' and
      Enum.all?([:cowboy, :proper, :fast_yaml, :crypto, :ssl, :xmerl_sax_parser], &Code.ensure_loaded?(&1))
    System.halt(if ok, do: 0, else: 1)' >/dev/null 2>&1
}

toolchain_stamp() { printf '%s %s %s' "$TOOLCHAIN_REVISION" "$TOOLCHAIN_SUITE" "$(dpkg --print-architecture)"; }

toolchain_install() {
  if [ -x "$AERIE_TOOLCHAIN/bin/elixir" ] && [ "$(cat "$AERIE_TOOLCHAIN/.complete" 2>/dev/null)" = "$(toolchain_stamp 2>/dev/null)" ]; then
    return 0
  fi
  if toolchain_system_ok; then
    return 0
  fi
  have apt-get && have dpkg-deb && have dpkg || fail "no toolchain" \
    "this is not Debian or a relative of it, so there is nothing to download" "install $TOOLCHAIN_NEEDS on PATH and in Erlang's library folder"
  case $(dpkg --print-architecture) in
    amd64 | arm64) ;;
    *) fail "no toolchain for $(dpkg --print-architecture)" "only amd64 and arm64 are supported" "install $TOOLCHAIN_NEEDS" ;;
  esac
  lock "$AERIE_TOOLCHAIN.lock" "another set-up is running here; waiting for it"
  if [ "$(cat "$AERIE_TOOLCHAIN/.complete" 2>/dev/null)" = "$(toolchain_stamp)" ]; then
    unlock
    return 0
  fi
  # A running gateway reads modules from there when it first needs them. A link to another checkout's is only replaced itself.
  [ ! -d "$AERIE_TOOLCHAIN" ] || [ -L "$AERIE_TOOLCHAIN" ] || unused "$AERIE_TOOLCHAIN" || fail "the toolchain in $AERIE_TOOLCHAIN is outdated" \
    "it cannot be replaced while a gateway or a test uses it" "end those, then run this again"

  # All work happens in a folder beside the final one; the next set-up removes what an interrupted one leaves.
  together toolchain_make "$AERIE_TOOLCHAIN.new"
  unlock
}

toolchain_make() {
  local work=$1
  rm -rf "$work"
  toolchain_download "$work" "$(dpkg --print-architecture)"
  toolchain_unpack "$work"
  toolchain_wrap "$work"
  toolchain_check "$work"
  toolchain_stamp >"$work/.complete"
  rm -rf "$AERIE_TOOLCHAIN"
  mv "$work" "$AERIE_TOOLCHAIN"
}

# The mirror that this machine's own apt uses for Debian proper, or Debian's own name for it.
toolchain_mirror() {
  apt-get indextargets --format '$(REPO_URI) $(ORIGIN)' 'Created-By: Packages' 2>/dev/null |
    awk '$2 == "Debian" && $1 !~ /security/ { print $1; exit }'
}

# toolchain_lists WORK ARCHITECTURE: reads the package lists for it, and sets `apt` to how apt is called with them.
toolchain_lists() {
  local work=$1 architecture=$2 mirror keyring why cure log="$1/apt/log"
  mirror=$(toolchain_mirror)
  if [ -z "$mirror" ]; then
    # A container without package lists still names its mirror in the sources.
    mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 2>/dev/null | grep -v security | grep '/debian/\?$' | head -n 1 || true)
  fi
  [ -n "$mirror" ] || fail "no Debian mirror" "apt's sources name none" "add Debian to apt's sources, or install $TOOLCHAIN_NEEDS"
  keyring=/usr/share/keyrings/debian-archive-keyring.gpg
  [ -e "$keyring" ] || keyring=/usr/share/keyrings/debian-archive-keyring.pgp
  [ -e "$keyring" ] || fail "Debian's signing keys are missing" "packages could not be verified" "apt-get install debian-archive-keyring"

  mkdir -p "$work/apt/lists/partial" "$work/apt/cache/archives/partial" "$work/apt/empty"
  : >"$work/apt/status"
  printf 'deb [signed-by=%s] %s %s main\n' "$keyring" "$mirror" "$TOOLCHAIN_SUITE" >"$work/apt/sources.list"
  apt=(-q -o "APT::Architecture=$architecture" -o "APT::Architectures=$architecture"
    -o "Dir::State=$work/apt" -o "Dir::State::lists=$work/apt/lists" -o "Dir::State::status=$work/apt/status"
    -o "Dir::Cache=$work/apt/cache" -o "Dir::Etc::sourcelist=$work/apt/sources.list" -o "Dir::Etc::sourceparts=$work/apt/empty"
    -o "Dir::Etc::preferences=$work/apt/none" -o "Dir::Etc::preferencesparts=$work/apt/empty"
    -o Acquire::Languages=none -o "Acquire::IndexTargets::deb::DEP-11::DefaultEnabled=false"
    -o Acquire::Retries=3 -o "APT::Sandbox::User=$(id -un)")
  step "toolchain: reading the package lists of Debian $TOOLCHAIN_SUITE for $architecture from $mirror"
  # For apt a list that it cannot fetch is only a warning; here it is an error.
  if ! apt-get "${apt[@]}" -o APT::Update::Error-Mode=any update >"$log" 2>&1; then
    tail -n 3 "$log" >&2
    download_fault "$log"
    fail "cannot read the package lists of $mirror" "$why" "$cure"
  fi
}

# toolchain_fetch WORK PACKAGE ...: downloads them into WORK/debs
toolchain_fetch() {
  local work=$1 why cure
  shift
  mkdir -p "$work/debs"
  if ! (cd "$work/debs" && apt-get "${apt[@]}" download "$@" >"$work/apt/log" 2>&1); then
    tail -n 3 "$work/apt/log" >&2
    download_fault "$work/apt/log"
    fail "the download of Debian's packages failed" "$why" "$cure"
  fi
}

toolchain_download() {
  local work=$1 architecture=$2 apt gcc
  toolchain_lists "$work" "$architecture"
  step "toolchain: downloading Elixir, OTP, Cowboy, PropEr, fast_yaml, nats-server and xz (about 45 MB)"
  # The licence of GCC's libraries is in a package with GCC's version in its name.
  gcc=$(apt-cache "${apt[@]}" depends libgcc-s1 | sed -n 's/^ *Depends: \(gcc-[0-9]*-base\)$/\1/p')
  # shellcheck disable=SC2046 # a list of words on purpose
  toolchain_fetch "$work" $(toolchain_packages) $gcc base-files
}

# Unpacks the packages, and keeps in packages/ what a release has to tell of them: PACKAGE.files (their paths), PACKAGE.copyright, an
# index (name, version, architecture, source, the sources that are linked into its programs, SHA-256 of the .deb; separated by tabs), and
# the licences that Debian does not repeat.
toolchain_unpack() {
  local work=$1 deb name known="$1/packages"
  step "toolchain: unpacking"
  mkdir "$known"
  dpkg-deb --fsys-tarfile "$work"/debs/base-files_*.deb | tar -xf - -C "$known" --strip-components=4 ./usr/share/common-licenses
  rm "$work"/debs/base-files_*.deb
  for deb in "$work"/debs/*.deb; do
    dpkg-deb -x "$deb" "$work"
    name=$(dpkg-deb -f "$deb" Package)
    dpkg-deb --fsys-tarfile "$deb" | tar -tf - | sed -n 's,^\./\(.*[^/]\)$,\1,p' >"$known/$name.files"
    dpkg-deb -W --showformat='${Package}\t${Version}\t${Architecture}\t${source:Package}\t${Static-Built-Using}\t' "$deb"
    sha256sum "$deb" | cut -c 1-64
  done >"$known/index"
  # A package's folder may be a link to that of another one, so all have to be there.
  for deb in "$known"/*.files; do
    name=$(basename "$deb" .files)
    cp "$work/usr/share/doc/$name/copyright" "$known/$name.copyright"
  done
  rm -rf "$work/debs" "$work/apt" "$work/usr/share/doc" "$work/usr/share/man" "$work/usr/share/locale"
}

# toolchain_licences FOLDER ARCHITECTURE: brings FOLDER/packages/SOURCE.copyright of the sources that are linked into its programs. They are
# in further packages (36 MB), which only a release has a use for.
toolchain_licences() {
  local folder=$1
  lock "$folder.lock" "another set-up is running here; waiting for it"
  together toolchain_licences_locked "$@"
  # Not reached unless the caller goes on without them.
  local status=$?
  unlock
  return $status
}

toolchain_licences_locked() {
  local folder=$1 architecture=$2 work="$1/licences.new" apt source package missing=() packages=()
  for source in $(cut -f 5 "$folder/packages/index" | grep -o '[^ ,]* (=' | cut -d ' ' -f 1 | sort -u); do
    [ -e "$folder/packages/$source.copyright" ] || missing+=("$source")
  done
  [ ${#missing[@]} -gt 0 ] || return 0
  rm -rf "$work"
  toolchain_lists "$work" "$architecture"
  step "toolchain: downloading the licences of ${missing[*]}"
  # The smallest of a source's packages: each has them.
  apt-cache "${apt[@]}" dumpavail | awk -v sources="${missing[*]}" 'BEGIN { RS = ""; FS = "\n"; split(sources, list, " "); for (i in list) wanted[list[i]] }
    { name = from = size = ""
      for (i = 1; i <= NF; i++) { split($i, word, " ")
        if (word[1] == "Package:") name = word[2]; else if (word[1] == "Source:") from = word[2]; else if (word[1] == "Size:") size = word[2] }
      if (from == "") from = name
      if (from in wanted && (!(from in best) || size + 0 < least[from])) { best[from] = name; least[from] = size + 0 } }
    END { for (from in best) print from, best[from] }' >"$work/chosen"
  for source in "${missing[@]}"; do
    package=$(awk -v source="$source" '$1 == source { print $2 }' "$work/chosen")
    [ -n "$package" ] || fail "no package has the licence of $source" "it is gone from $TOOLCHAIN_SUITE" "make the toolchain again: remove $folder and run this again"
    packages+=("$package")
  done
  toolchain_fetch "$work" "${packages[@]}"
  for source in "${missing[@]}"; do
    package=${packages[0]} packages=("${packages[@]:1}")
    dpkg-deb -x "$work/debs/${package}"_*.deb "$work/$source"
    cp "$work/$source/usr/share/doc/$package/copyright" "$folder/packages/$source.copyright"
  done
  rm -rf "$work"
}

# Wraps one ELF program, so that it finds the unpacked loader wherever the folder is.
# $1: the program; $2: the path from its folder up to the toolchain's top
toolchain_wrap_elf() {
  local program=$1 up=$2 triplet=$3 loader=$4
  mv "$program" "$program.elf"
  cat >"$program" <<WRAPPER
#!/bin/sh
d=\${0%/*}; t=\$d/$up; l=\$t/usr/lib/$triplet
exec "\$l/$loader" --library-path "\$l" --argv0 "\$0" "\$d/${program##*/}.elf" "\$@"
WRAPPER
  chmod 755 "$program"
}

toolchain_wrap() {
  local work=$1 triplet loader file erts name
  triplet=$(basename "$(dirname "$(ls -d "$work"/usr/lib/*-linux-gnu/libc.so.6)")")
  loader=$(basename "$(ls "$work/usr/lib/$triplet"/ld-linux-*.so.*)")
  erts=$(basename "$(ls -d "$work"/usr/lib/erlang/erts-*)")

  for file in "$work/usr/lib/erlang/$erts"/bin/*; do
    is_elf "$file" && toolchain_wrap_elf "$file" ../../../../.. "$triplet" "$loader"
  done
  for file in "$work"/usr/lib/erlang/bin/*; do
    is_elf "$file" && toolchain_wrap_elf "$file" ../../../.. "$triplet" "$loader"
  done
  toolchain_wrap_elf "$work/usr/sbin/nats-server" ../.. "$triplet" "$loader"
  toolchain_wrap_elf "$work/usr/bin/xz" ../.. "$triplet" "$loader"

  # Debian's `erl` sets ROOTDIR to its installed path; this one uses the folder that it is in.
  cat >"$work/usr/lib/erlang/bin/erl" <<ERL
#!/bin/sh
ROOTDIR=\$(cd "\${0%/*}/.." && pwd -P)
BINDIR=\$ROOTDIR/$erts/bin
EMU=beam
PROGNAME=\${0##*/}
export ROOTDIR BINDIR EMU PROGNAME
exec "\$BINDIR/erlexec" "\$@"
ERL
  cp "$work/usr/lib/erlang/bin/erl" "$work/usr/lib/erlang/$erts/bin/erl"
  sed -i 's|/bin/\.\." |/../.." |; s|^ROOTDIR=.*|ROOTDIR=$(cd "${0%/*}/../.." \&\& pwd -P)|' "$work/usr/lib/erlang/$erts/bin/erl"

  mkdir -p "$work/bin"
  for name in erl erlc escript dialyzer epmd; do
    toolchain_forward "$work" "$name" "usr/lib/erlang/bin/$name"
  done
  for name in elixir elixirc iex; do toolchain_forward "$work" "$name" "usr/lib/elixir/bin/$name"; done
  # `elixir -S mix` reads this file as Elixir, so it cannot be a wrapper.
  cp "$work/usr/lib/elixir/bin/mix" "$work/bin/mix"
  toolchain_forward "$work" nats-server usr/sbin/nats-server
  toolchain_forward "$work" xz usr/bin/xz
}

toolchain_forward() {
  [ -e "$1/$3" ] || return 0
  printf '#!/bin/sh\nd=$(cd "${0%%/*}/.." && pwd -P)\nexec "$d/%s" "$@"\n' "$3" >"$1/bin/$2"
  chmod 755 "$1/bin/$2"
}

is_elf() { [ -f "$1" ] && [ ! -L "$1" ] && [ "$(head -c 4 "$1" | od -An -c | tr -d ' ')" = '177ELF' ]; }

toolchain_check() {
  local work=$1 found
  found=$(PATH=$work/bin:$PATH elixir --erl +fnu -e '
    {:ok, _} = Application.ensure_all_started([:crypto, :ssl, :cowboy])
    true = Enum.all?([:proper, :fast_yaml, :dialyzer], &Code.ensure_loaded?(&1))
    {:ok, _} = Application.ensure_all_started(:fast_yaml)
    _ = :crypto.hash(:sha256, "x")
    IO.write("Elixir #{System.version()} on OTP #{System.otp_release()}")' 2>"$work/check.log") ||
    { tail -n 5 "$work/check.log" >&2; fail "the unpacked toolchain does not run" "see above" "report it with the lines above; $work is kept"; }
  step "toolchain: $found, nats-server $("$work/bin/nats-server" --version | sed 's/.* v//'), $("$work/bin/xz" --version | sed -n '1s/.*) /xz /p')"
}

# A small C program drives serial ports. Everything else works without a compiler, so this is only a warning.
toolchain_compiler_note() {
  have cc || have gcc || have clang ||
    warn "no C compiler: serial ports (DEVICE,BAUD) will not work; everything else does. To fix it: apt-get install gcc libc6-dev"
}
