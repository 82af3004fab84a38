# A private Python environment with the peers that the tests talk to (pymavlink, MAVSDK, MAVProxy, YAMSPy, nats-py). Sourced by bin/setup
# and bin/test.
# Only tests and benchmark comparisons need it; the gateway itself uses no Python.

. "$AERIE_ROOT/bin/lib/download.sh"

AERIE_VENV=${AERIE_VENV:-$AERIE_ROOT/.venv}
export AERIE_VENV

# pymavlink needs wsproto for WebSockets; MAVProxy needs pyserial and defusedxml to start. docs/clients/command.py is what signs commands.
PYTHON_PEERS="pymavlink==2.4.50 wsproto==1.3.2 pyserial==3.5 defusedxml==0.7.1 nats-py==2.16.0 cryptography==50.0.2"

# Installed without their dependencies: MAVProxy's are half a gigabyte of GUI, maps and video.
PYTHON_PEERS_ALONE="MAVProxy==1.8.75"
# YAMSPy, the peer of MSP, has no wheel.
PYTHON_PEERS_BUILT="YAMSPy==0.3.3"

# MAVSDK has binaries for these machines only; elsewhere its tests are left out.
case "$(uname -s) $(uname -m)" in
  "Linux x86_64" | "Linux aarch64") PYTHON_PEERS_ALONE="$PYTHON_PEERS_ALONE mavsdk==4.1.0" ;;
esac

python_stamp() { printf '%s %s %s %s' "$PYTHON_PEERS" "$PYTHON_PEERS_ALONE" "$PYTHON_PEERS_BUILT" "$(python3 -c 'import sys; print(sys.version_info[:2])' 2>/dev/null)"; }

# Not pip's own script, which names the folder that it was installed in.
python_pip() { "$AERIE_VENV/bin/python" -m pip install --quiet --disable-pip-version-check "$@"; }

python_install() {
  [ "$(cat "$AERIE_VENV/.complete" 2>/dev/null)" = "$(python_stamp)" ] && [ -x "$AERIE_VENV/bin/python" ] && return 0
  have python3 || fail "no python3" "the tests use pymavlink as an independent peer" \
    "apt-get install python3 python3-venv"
  lock "$AERIE_VENV.lock" "another set-up is running here; waiting for it"
  if [ "$(cat "$AERIE_VENV/.complete" 2>/dev/null)" = "$(python_stamp)" ]; then
    unlock
    return 0
  fi
  together python_make
  # Not reached unless the caller goes on without it.
  local status=$?
  unlock
  return $status
}

python_make() {
  local why cure log="$AERIE_VENV.log"
  step "python: installing $PYTHON_PEERS $PYTHON_PEERS_ALONE $PYTHON_PEERS_BUILT into .venv/ (for the tests only)"
  rm -rf "$AERIE_VENV"
  if ! python3 -m venv "$AERIE_VENV" >"$log" 2>&1; then
    rm -rf "$AERIE_VENV"
    fail "python3 cannot create a virtual environment" "its venv or ensurepip module is missing; the whole output is in $log" \
      "apt-get install python3-venv"
  fi
  # shellcheck disable=SC2086 # lists of words on purpose
  if ! { python_pip --only-binary :all: $PYTHON_PEERS || python_pip $PYTHON_PEERS; } >"$log" 2>&1 ||
    ! python_pip --no-deps --only-binary :all: $PYTHON_PEERS_ALONE >>"$log" 2>&1 ||
    ! python_pip --no-deps $PYTHON_PEERS_BUILT >>"$log" 2>&1; then
    rm -rf "$AERIE_VENV"
    tail -n 3 "$log" >&2
    download_fault "$log"
    fail "pip could not install $PYTHON_PEERS $PYTHON_PEERS_ALONE $PYTHON_PEERS_BUILT" "$why; the output is in $log" "$cure"
  fi
  rm -f "$log"
  python_stamp >"$AERIE_VENV/.complete"
}

# The long test of REST asks it; it has an environment of its own because it brings forty packages along. Without it the test says
# that it was left out.
SCHEMATHESIS="schemathesis==4.32.5"

schemathesis_install() {
  local folder="$AERIE_ROOT/.schemathesis" why cure
  if [ "$(cat "$folder/.complete" 2>/dev/null)" != "$SCHEMATHESIS" ]; then
    step "python: installing $SCHEMATHESIS into .schemathesis/ (for the long tests only)"
    rm -rf "$folder"
    if ! together schemathesis_make "$folder" >"$folder.log" 2>&1; then
      download_fault "$folder.log"
      warn "REST is not tested against its description: pip could not install $SCHEMATHESIS ($why; the output is in $folder.log). To fix it: $cure"
      return 1
    fi
    rm -f "$folder.log"
    echo "$SCHEMATHESIS" >"$folder/.complete"
  fi
  PATH="$folder/bin:$PATH"
}

schemathesis_make() { python3 -m venv "$1" && "$1/bin/python" -m pip install --quiet --disable-pip-version-check "$SCHEMATHESIS"; }
