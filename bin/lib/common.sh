# Shared by the scripts in bin/: where the checkout is, how to speak, how to find the toolchain.
# Sourced, never run. Bash.

set -euo pipefail

AERIE_ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)
export AERIE_ROOT

# A private toolchain lives inside the checkout; AERIE_TOOLCHAIN points several checkouts at one.
AERIE_TOOLCHAIN=${AERIE_TOOLCHAIN:-$AERIE_ROOT/.toolchain}
export AERIE_TOOLCHAIN

# What the code needs (design: Elixir 1.20 for its type checker, OTP 29).
AERIE_MIN_ELIXIR=1.20.0
AERIE_MIN_OTP=29

say() { printf '%s\n' "$*"; }
step() { printf '==> %s\n' "$*" >&2; }
warn() { printf 'warning: %s\n' "$*" >&2; }

# fail WHAT WHY MEND: one line each time, so that the cure is never lost in a log.
fail() {
  printf 'error: %s (%s). To mend it: %s\n' "$1" "$2" "$3" >&2
  exit 1
}

have() { command -v "$1" >/dev/null 2>&1; }

# Takes an exclusive lock for the rest of the script, so that two set-ups at once do not mix their files.
lock() {
  mkdir -p "$(dirname "$1")"
  if have flock; then
    exec 9>"$1"
    flock -n 9 || { step "another set-up is running here; waiting for it"; flock 9; }
  fi
}

# Puts the private toolchain, if there is one, first on PATH.
use_toolchain() {
  if [ -x "$AERIE_TOOLCHAIN/bin/elixir" ]; then
    PATH=$AERIE_TOOLCHAIN/bin:$PATH
    export PATH
  fi
  export MIX_HOME="$AERIE_ROOT/.mix"
  export ELIXIR_ERL_OPTIONS="${ELIXIR_ERL_OPTIONS:-} +fnu"
  export LANG=${LANG:-C.UTF-8}
  # A bare Debian root has no locale; names of files are UTF-8 all the same.
  case $LANG in *UTF-8 | *utf8) ;; *) export LC_ALL=C.UTF-8 ;; esac
}

# Compiles everything for the environment $1 and shows the output only when it fails. A terminal sees that it goes on.
compile_quietly() {
  local log="$AERIE_ROOT/_build/compile-$1.log" pid
  mkdir -p "$AERIE_ROOT/_build"
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
}
