# Waits for the end of a gateway that a terminal's script has started. For any sh; bin/run and a release's bin/aerie source it.

# attend PID: Ctrl-C becomes a SIGTERM for an orderly end (links closed, outbox written, nats-server stopped), which is awaited.
# A second Ctrl-C, or ten seconds, kill it. Ends the script: with 0 if it was asked to, else with the gateway's status.
attend() {
  child=$1
  asked=no
  watchdog=
  trap attend_end INT TERM HUP
  while :; do
    status=0
    wait "$child" || status=$?
    kill -0 "$child" 2>/dev/null || break
  done
  [ -z "$watchdog" ] || { pkill -P "$watchdog" 2>/dev/null || true; kill "$watchdog" 2>/dev/null || true; }
  [ "$asked" = no ] || exit 0
  exit "$status"
}

attend_end() {
  [ "$asked" = no ] || { kill -KILL "$child" 2>/dev/null; return; }
  asked=yes
  kill -TERM "$child" 2>/dev/null || true
  # Without 2>/dev/null the shell would print "Terminated".
  (sleep 10; kill -KILL "$child") 2>/dev/null &
  watchdog=$!
  # So that bash does not report its end.
  if command -v disown >/dev/null 2>&1; then disown "$watchdog"; fi
}
