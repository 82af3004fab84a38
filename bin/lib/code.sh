# Compiles Aerie and makes copies of the compiled code that do not change. Sourced by the scripts that compile or run it.
#
# Mix writes compiled modules in place, and the BEAM reads a module when it is first called. A gateway that ran from Mix's
# folder would load new code, or none, while somebody compiles. So each program runs from a copy in _build/run/, named
# by a hash of its content, and holds a shared lock on that folder while it runs. A start removes copies that nobody holds.

# Compiles everything for the environment $1, one caller at a time, and shows the output only if it fails. A terminal
# shows progress. $2: a function that is called with $1 before the next caller may compile.
compile_quietly() {
  lock "$AERIE_ROOT/_build/compile-$1.lock" "another start is compiling here; waiting for it"
  compile_locked "$1"
  [ -z "${2:-}" ] || "$2" "$1"
  unlock
}

compile_locked() {
  local log="$AERIE_ROOT/_build/compile-$1.log"
  mkdir -p "$AERIE_ROOT/_build"
  together compile_shown "$1" "$log" || {
    cat "$log" >&2
    fail "Aerie did not compile" "see above" "check your changes with git status; if there are none, report the lines above"
  }
}

compile_shown() {
  local log=$2 pid
  (cd "$AERIE_ROOT" && MIX_ENV=$1 mix compile) >"$log" 2>&1 &
  pid=$!
  if [ -t 2 ]; then
    while kill -0 "$pid" 2>/dev/null; do
      printf '\r    %-76.76s' "$(tail -n 1 "$log" | tr -d '\r')" >&2
      sleep 0.5
    done
    printf '\r%80s\r' '' >&2
  fi
  wait "$pid"
}

# Compiles and sets AERIE_CODE to a copy of the result, which this process and its children hold. It compiles for prod; tests set
# AERIE_BUILD=test, because their code is compiled already (bin/test --full does as users do).
# If nothing has changed, it takes the last copy without asking Mix: a gateway that was killed in flight must start again
# quickly, and Mix takes longer than all the rest. With `any`, the last copy will do while another start compiles; with
# `last`, it will also do when the sources have changed since.
code_install() {
  local build=${AERIE_BUILD:-prod} stamp begun digest
  stamp="$AERIE_ROOT/_build/code-$build"
  if ! lock_soon "$AERIE_ROOT/_build/compile-$build.lock"; then
    if [ -n "${1:-}" ] && code_last "$stamp"; then
      step "another start is compiling here; this is the program as it was before"
      unlock
      return 0
    fi
    step "another start is compiling here; waiting for it"
    flock 9
  fi
  if AERIE_CODE=$(code_known "$stamp"); then
    export AERIE_CODE
    hold "$AERIE_CODE"
    remove_unused_copies
    unlock
    return 0
  fi
  if [ "${1:-}" = last ] && code_last "$stamp"; then
    step "the sources have changed since the last start; this is the program as it was then"
    unlock
    return 0
  fi
  step "compiling what has changed (all of it takes some minutes)"
  # Sources that change from here on are newer than the stamp. Whoever waits for the lock finds the stamp.
  begun=$(date +%s.%N)
  digest=$(code_digest)
  compile_locked "$build"
  code_copy "$build"
  printf '%s\n%s\n%s\n' "$digest" "$(code_elixir)" "${AERIE_CODE##*/}" >"$stamp.$$"
  touch -d "@$begun" "$stamp.$$"
  mv "$stamp.$$" "$stamp"
  unlock
}

# The Elixir in use, by a name that a copy of the checkout has as well.
code_elixir() {
  local elixir
  elixir=$(command -v elixir) || return 0
  printf '%s\n' "${elixir#"$AERIE_ROOT/"}"
}

# code_sources FIND'S WORDS ...: what is compiled, without what only tests and running gateways use
code_sources() {
  (cd "$AERIE_ROOT" && find -L apps packages rel mix.exs config bin/lib/code.sh bin/lib/copy_code.exs \
    "$(command -v elixir)" "$AERIE_TOOLCHAIN/packages/index" \
    \( -name test -o -name tmp -o -name cover -o -name var -o -name _build -o -name '.*' \) -prune -o \
    "$@" 2>/dev/null) || true
}

# The content of what is compiled, whatever the times of the files.
code_digest() {
  code_sources -type f -print0 | sort -z | (cd "$AERIE_ROOT" && xargs -0 sha256sum) |
    sed "s|$AERIE_ROOT/||" | sha256sum | cut -c 1-64
}

# Prints the copy that the file $1 names, if no source, source folder or toolchain is newer than the file, or if their
# content is as it was: a checkout that was copied has other times.
code_known() {
  local digest elixir code begun
  code_read "$1" || return 1
  if [ -n "$(code_sources \( -newer "$1" -o -cnewer "$1" \) -print -quit)" ]; then
    begun=$(date +%s.%N)
    [ "$(code_digest)" = "$digest" ] || return 1
    touch -d "@$begun" "$1"
  fi
  printf '%s\n' "$code"
}

# Reads the file $1 into digest, elixir and code; false if there is no such copy, or it was made by another Elixir.
code_read() {
  { read -r digest && read -r elixir && read -r code; } 2>/dev/null <"$1" || return 1
  code=$AERIE_ROOT/_build/run/$code
  [ "$elixir" = "$(code_elixir)" ] && [ -d "$code" ]
}

# Takes the copy that the file $1 names, whatever has changed since, unless it is being removed.
code_last() {
  local digest elixir code
  code_read "$1" || return 1
  AERIE_CODE=$code
  hold "$AERIE_CODE"
  [ -d "$AERIE_CODE/consolidated" ] || return 1
  export AERIE_CODE
}

code_copy() {
  local build="$AERIE_ROOT/_build/$1" copies="$AERIE_ROOT/_build/run" key log
  key=$(cd "$build" && find -L . -path ./.mix -prune -o -path './lib/*/.mix' -prune -o -path './lib/*/consolidated' -prune -o -type f -print0 | sort -z |
    xargs -0 sha256sum | cat - "$AERIE_ROOT/config/config.exs" | sha256sum | cut -c 1-16)
  AERIE_CODE="$copies/$1-$key"
  export AERIE_CODE
  if [ ! -d "$AERIE_CODE" ]; then
    rm -rf "$copies/new"
    # Mix's remarks are not the program's output.
    log="$AERIE_ROOT/_build/copy-$1.log"
    together mix_copy "$1" "$copies/new" >"$log" 2>&1 || {
      cat "$log" >&2
      fail "the compiled code could not be copied" "see above" "make room on the disk, or remove _build/ and run this again"
    }
    mv "$copies/new" "$AERIE_CODE"
  fi
  hold "$AERIE_CODE"
  remove_unused_copies
}

mix_copy() { cd "$AERIE_ROOT" && MIX_ENV=$1 mix run --no-start --no-compile bin/lib/copy_code.exs "$2"; }

# To be called with the lock: a copy that is being made is held by nobody.
remove_unused_copies() {
  local other
  for other in "$AERIE_ROOT/_build/run/${AERIE_BUILD:-prod}"-*; do
    # Whoever takes it meanwhile waits for its end.
    if have flock; then flock -n -x "$other" rm -rf "$other" || true; fi
  done
}
