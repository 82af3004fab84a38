# --help of bin/run and bin/aerie in a checkout: answered from help.txt, so that nothing is downloaded or compiled for
# it. For any sh.

# help_answer PROGRAM WORD ...: prints the help that the words of `aerie` ask for, and ends the script; returns if they
# ask for something else. PROGRAM stands for `aerie start` in the text.
help_answer() {
  program=$1
  shift
  case ${1:-} in '' | -h | --help | help) help_print "(all)" ;; esac
  help_find "$@" || return 0
  for word in "$@"; do
    case $word in
      -h | --help) help_print "$section" ;;
      --) return 0 ;;
    esac
  done
}

# Sets `section` to the one of these words, two words before one: `config check` is a section, and `config` lists those
# below it.
help_find() {
  for section in "${1:-} ${2:-}" "${1:-}"; do
    ! grep -qxF "@ $section" "$AERIE_ROOT/bin/lib/help.txt" || return 0
  done
  return 1
}

help_section() {
  awk -v wanted="@ $1" '/^@/ { printing = ($0 == wanted); next } printing' "$AERIE_ROOT/bin/lib/help.txt"
}

# True if these words of `aerie` are a question to a running gateway.
help_asks_gateway() { help_find "$@" && help_section "$section" | grep -q '^ *--gateway '; }

# Ends as the program does: a full disk is an error, a reader that has seen enough is not.
help_print() {
  trap '' PIPE
  text=$(help_section "$1" | sed "s|aerie start|$program|g")
  { why=$(printf '%s\n' "$text" | LC_ALL=C cat 2>&1 >&4) || true; } 4>&1
  case $why in '' | *[Bb]roken*) exit 0 ;; esac
  why=$(printf %s "${why##*: }" | tr '[:upper:]' '[:lower:]')
  printf 'error: standard output takes nothing: %s\n' "$why" >&2 || true
  exit 2
}
