# What a page tells its reader to type. Sourced by run.

# `session`: what the reader has exported
page= walked=() where=() session=

# guide PAGE: the following steps walk this page.
guide() { page=$AERIE_ROOT/$1 walked=() session=; }

# at NAME USER FOLDER: where the following steps are typed
at() { where=("$@"); }

# commands PAGE: its commands, one a line, without comments: those of fenced blocks without a language. In a block with prompts the other lines
# are answers. A block after the comment <!-- not run: ... --> or <!-- run by ... --> is left out.
commands() {
  awk '
    /^<!-- (not run|run by)/ { skip = 1 }
    /^```/ { if (inside) { flush() } else { inside = 1; plain = ($0 == "```"); n = 0; prompts = 0; next } }
    inside { lines[++n] = $0; if ($0 ~ /^\$ /) prompts = 1; next }
    !inside && /[^ ]/ && !/^<!--/ { skip = 0 }
    function flush(   i, line, command) {
      inside = 0
      if (plain && !skip)
        for (i = 1; i <= n; i++) {
          line = lines[i]
          if (prompts && !sub(/^\$ /, "", line)) continue
          while (line ~ /\\$/ && i < n) { sub(/ *\\$/, "", line); i++; sub(/^ +/, "", lines[i]); line = line " " lines[i] }
          sub(/ +# .*/, "", line); sub(/ +$/, "", line)
          if (line != "" && line !~ /^#/) print line
        }
      skip = 0
    }' "$1"
}

# said TEXT: it is a command of the page.
said() {
  commands "$page" | grep -qxF -- "$1" || fail "${page##*/} does not say: $1"
  walked+=("$1")
}

# step COMMAND [INSTEAD]: types a command of the page, or, where the page says that the reader has to put in something else, that.
step() {
  said "$1"
  say "$ ${2:-$1}"
  in_root "${where[@]}" "$session ${2:-$1}"
}

# step_says COMMAND TEXT [INSTEAD]: one whose answer has this text
step_says() {
  local answer
  said "$1"
  say "$ ${3:-$1}"
  local status=0
  answer=$(in_root "${where[@]}" "$session ${3:-$1}") || status=$?
  printf '%s\n' "$answer"
  [ $status = 0 ] || fail "it ended with status $status"
  case $answer in *"$2"*) ;; *) fail "the answer does not say: $2" ;; esac
}

# step_export COMMAND NAME: one that exports NAME to the following ones
step_export() {
  said "$1"
  say "$ $1"
  session="$session export $2='$(in_root "${where[@]}" "$1; printf %s \"\$$2\"")';"
}

# step_on COMMAND LOG: begins one that goes on until it is stopped; its output is in $CACHE/LOG.
step_on() {
  local log=$2
  said "$1"
  say "$ $1 &"
  in_root "${where[@]}" "$session exec $1" >"$CACHE/$log" 2>&1 </dev/null &
}

# not_here COMMAND REASON: a command of the page that is not walked
not_here() {
  said "$1"
  say "not here ($2): $1"
}

# block TEXT: the fenced block with a language that has this text
block() {
  awk -v text="$1" '
    /^```/ { if (inside) { if (index(all, text)) { printf "%s", all; exit }; inside = 0 } else { inside = 1; all = "" }; next }
    inside { all = all $0 "\n" }' "$page" | grep . || fail "${page##*/} has no block with: $1"
}

# guide_ends: every command of the page was walked.
guide_ends() {
  local command one
  while IFS= read -r command; do
    for one in ${walked[@]+"${walked[@]}"}; do [ "$one" != "$command" ] || continue 2; done
    fail "${page##*/} says what no step types: $command"
  done < <(commands "$page")
}
