# Compiled code that nobody changes. Sourced by the scripts that compile or run Aerie.
#
# Mix writes compiled modules in place, and the BEAM reads a module when it is first called: a gateway that ran from Mix's
# folder would get new code, or none, from whoever compiles beside it. So each program runs from a copy in _build/run/,
# named by what is in it, and holds a shared lock on that folder for as long as it lives. A start removes the copies that
# nobody holds: there are as many as different ones run, and one.

# Compiles everything for the environment $1, one caller at a time, and shows the output only when it fails. A terminal
# sees that it goes on. $2: a function to be called with $1 before anybody else may compile.
compile_quietly() {
  local log="$AERIE_ROOT/_build/compile-$1.log" pid
  mkdir -p "$AERIE_ROOT/_build"
  lock "$AERIE_ROOT/_build/compile-$1.lock" "another start is compiling here; waiting for it"
  (cd "$AERIE_ROOT" && MIX_ENV=$1 mix compile) >"$log" 2>&1 &
  pid=$!
  if [ -t 2 ]; then
    while kill -0 "$pid" 2>/dev/null; do
      printf '\r    %-76.76s' "$(tail -n 1 "$log" | tr -d '\r')" >&2
      sleep 0.5
    done
    printf '\r%80s\r' '' >&2
  fi
  wait "$pid" || {
    cat "$log" >&2
    fail "Aerie did not compile" "see above" "git status shows what was changed here; otherwise report it with the lines above"
  }
  [ -z "${2:-}" ] || "$2" "$1"
  unlock
}

# Compiles for the environment $1 and sets AERIE_CODE to a copy of the result, which this process and its children hold.
# When nothing was changed since, the copy of the last time is taken as it is: a gateway that was killed in flight is started
# again, and asking Mix takes longer than all the rest.
code_install() {
  local stamp="$AERIE_ROOT/_build/code-$1" begun
  lock "$AERIE_ROOT/_build/compile-$1.lock" "another start is compiling here; waiting for it"
  if AERIE_CODE=$(code_known "$stamp"); then
    export AERIE_CODE
    hold "$AERIE_CODE"
    unlock
    return 0
  fi
  unlock
  # What changes from here on is newer.
  begun=$(date +%s.%N)
  compile_quietly "$1" code_copy
  printf '%s\n%s\n' "$(command -v elixir)" "$AERIE_CODE" >"$stamp.$$"
  touch -d "@$begun" "$stamp.$$"
  mv "$stamp.$$" "$stamp"
}

# The copy that the file $1 names, when no source, folder of sources or toolchain is newer than the file.
code_known() {
  local elixir code newer
  { read -r elixir && read -r code; } 2>/dev/null <"$1" || return 1
  [ "$elixir" = "$(command -v elixir)" ] && [ -d "$code" ] || return 1
  # A toolchain of the system's has no such mark.
  newer=$(cd "$AERIE_ROOT" && find -L apps packages mix.exs config bin/lib "$elixir" "$AERIE_TOOLCHAIN/.complete" \
    \( -name test -o -name tmp \) -prune -o \( -newer "$1" -o -cnewer "$1" \) -print -quit 2>/dev/null) || true
  [ -z "$newer" ] && printf '%s\n' "$code"
}

code_copy() {
  local build="$AERIE_ROOT/_build/$1" copies="$AERIE_ROOT/_build/run" key other
  key=$(cd "$build" && find -L . -path ./.mix -prune -o -path './lib/*/.mix' -prune -o -type f -print0 | sort -z |
    xargs -0 sha256sum | cat - "$AERIE_ROOT/config/config.exs" | sha256sum | cut -c 1-16)
  AERIE_CODE="$copies/$1-$key"
  export AERIE_CODE
  if [ ! -d "$AERIE_CODE" ]; then
    rm -rf "$copies/new"
    (cd "$AERIE_ROOT" && MIX_ENV=$1 mix run --no-start --no-compile bin/lib/copy_code.exs "$copies/new") >&2
    mv "$copies/new" "$AERIE_CODE"
  fi
  hold "$AERIE_CODE"
  for other in "$copies"/*; do
    if unused "$other"; then rm -rf "$other"; fi
  done
}
