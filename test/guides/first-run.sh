# README: from nothing to three flying vehicles, and a command.
guide README.md
root hub
checkout hub
at hub pilot "$PILOT/aerie"

before=$(received) began=$SECONDS
step_export "export AERIE_API_KEY=\$(head -c 16 /dev/urandom | od -An -tx1 | tr -d ' \\n')" AERIE_API_KEY
step_on 'bin/run' first-run.log
PATIENCE=900 until_ok 'three vehicles fly' in_root "${where[@]}" \
  'bin/aerie status --json | grep -o "\"armed\":true" | wc -l | grep -qx 3 && bin/aerie status'
say "three vehicles fly $((SECONDS - began)) s after the first command; $((($(received) - before) / 1000000)) MB were received"

curl_hold="curl -H \"X-Aerie-Key: \$AERIE_API_KEY\" -H \"Content-Type: application/json\" -d '{\"type\": \"hold\"}' http://127.0.0.1:4000/api/vehicles/sim-001/commands"
step_says "$curl_hold" '"result":"completed"' "$curl_hold --silent --show-error"
not_here bin/test "CI runs it"
in_root "${where[@]}" '[ "$(stat -c %a var)" = 700 ] && bin/aerie stop'
guide_ends
