# A private Python environment with the peers that the tests talk to (pymavlink). Sourced by bin/setup and bin/test.
# Only tests and the benchmark's comparison need it; the gateway itself has no Python.

AERIE_VENV=${AERIE_VENV:-$AERIE_ROOT/.venv}
export AERIE_VENV

PYTHON_PEERS="pymavlink==2.4.50"

python_stamp() { printf '%s %s' "$PYTHON_PEERS" "$(python3 -c 'import sys; print(sys.version_info[:2])' 2>/dev/null)"; }

python_install() {
  [ "$(cat "$AERIE_VENV/.complete" 2>/dev/null)" = "$(python_stamp)" ] && [ -x "$AERIE_VENV/bin/python" ] && return 0
  have python3 || fail "no python3" "the tests talk to pymavlink, a MAVLink implementation that is not ours" \
    "apt-get install python3 python3-venv"
  lock "$AERIE_VENV.lock"
  [ "$(cat "$AERIE_VENV/.complete" 2>/dev/null)" = "$(python_stamp)" ] && return 0
  local log="$AERIE_VENV.log"
  step "python: a private environment with $PYTHON_PEERS (for the tests only)"
  rm -rf "$AERIE_VENV"
  if ! python3 -m venv "$AERIE_VENV" >"$log" 2>&1; then
    rm -rf "$AERIE_VENV"
    fail "python3 cannot make a virtual environment" "its venv or ensurepip module is missing; the whole answer is in $log" \
      "apt-get install python3-venv"
  fi
  # shellcheck disable=SC2086 # a list of words on purpose
  if ! "$AERIE_VENV/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: $PYTHON_PEERS >"$log" 2>&1 &&
    ! "$AERIE_VENV/bin/pip" install --quiet --disable-pip-version-check $PYTHON_PEERS >"$log" 2>&1; then
    rm -rf "$AERIE_VENV"
    tail -n 3 "$log" >&2
    fail "pip could not install $PYTHON_PEERS" "no network, or PyPI does not answer" "check the network and run this again"
  fi
  rm -f "$log"
  python_stamp >"$AERIE_VENV/.complete"
}
