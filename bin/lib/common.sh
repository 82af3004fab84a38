# Shared by the scripts in bin/: paths, messages, locks, the toolchain's environment. Sourced, never run. Bash.

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
# A message that cannot be written (a full disk) ends no script.
step() { printf '==> %s\n' "$*" >&2 || true; }
warn() { printf 'warning: %s\n' "$*" >&2 || true; }

# fail WHAT WHY CURE: one line, so that the cure is never separated from the error in a log.
fail() {
  printf 'error: %s (%s). To fix it: %s\n' "$1" "$2" "$3" >&2
  exit 1
}

case $AERIE_ROOT in
  *['][{}*?\:;']*) fail "$AERIE_ROOT: the programs that Aerie consists of cannot run from a folder of this name" \
    "Elixir takes [ ] { } * ? and \\ for a pattern, and : and ; separate the folders of a list" "rename it; spaces, quotes and letters of any language are fine" ;;
esac

have() { command -v "$1" >/dev/null 2>&1; }

# lock FILE MESSAGE: takes an exclusive lock until `unlock`, or until the script and its children have ended. Prints
# MESSAGE if it has to wait for more than half a second. Without flock there are no locks; Linux has it.
lock() {
  lock_soon "$1" || { step "$2"; flock 9; }
}
# The same, but returns 1 after that half second.
lock_soon() {
  mkdir -p "$(dirname "$1")"
  have flock || return 0
  exec 9>"$1"
  flock -w 0.5 9
}
unlock() { exec 9>&-; }

# together COMMAND ...: runs a command, or a function of these scripts in a process of its own, without input. What ends this script (Ctrl-C, SIGTERM,
# a closed terminal) ends all that the command has started; without that a compiler or a download would go on by itself.
together() {
  local former status=0
  former=$(trap -p INT TERM HUP)
  together=
  trap 'together_end 130' INT
  trap 'together_end 143' TERM
  trap 'together_end 129' HUP
  # With job control it has a process group of its own.
  set -m
  "$@" </dev/null &
  together=$!
  set +m
  wait "$together" || status=$?
  trap - INT TERM HUP
  eval "$former"
  return $status
}

together_end() {
  local tries=50
  trap '' INT TERM HUP
  [ -n "$together" ] || exit "$1"
  kill -TERM -- "-$together" 2>/dev/null || true
  while [ $tries -gt 0 ] && kill -0 -- "-$together" 2>/dev/null; do
    tries=$((tries - 1))
    sleep 0.1
  done
  kill -KILL -- "-$together" 2>/dev/null || true
  exit "$1"
}

# hold FOLDER: keeps other scripts from replacing or removing the folder while this script or a child of it runs.
hold() {
  local held
  have flock || return 0
  exec {held}<"$1"
  flock -s "$held"
}

# True if nobody holds the folder. Without flock it counts as held.
unused() { have flock && flock -n -x "$1" true; }

# Puts the private toolchain, if there is one, first on PATH.
use_toolchain() {
  if [ -x "$AERIE_TOOLCHAIN/bin/elixir" ]; then
    PATH=$AERIE_TOOLCHAIN/bin:$PATH
    export PATH
    hold "$AERIE_TOOLCHAIN"
  fi
  export MIX_HOME="$AERIE_ROOT/.mix"
  export ELIXIR_ERL_OPTIONS="${ELIXIR_ERL_OPTIONS:-} +fnu"
  export LANG=${LANG:-C.UTF-8}
  # A minimal Debian has no locale, but file names are UTF-8.
  case $LANG in *UTF-8 | *utf8) ;; *) export LC_ALL=C.UTF-8 ;; esac
}
