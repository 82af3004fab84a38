# docs/clients/command.go as a program in .go/, for the test that runs it. Sourced by bin/setup and bin/test. Go compares each module with
# its checksum in go.sum.

go_client_install() {
  have go || { warn "the client in Go is not tested: there is no go on the PATH"; return 1; }
  local log="$AERIE_ROOT/.go.log"
  if ! (cd "$AERIE_ROOT/docs/clients" && go build -o "$AERIE_ROOT/.go/command" .) >"$log" 2>&1; then
    rm -rf "$AERIE_ROOT/.go"
    warn "the client in Go is not tested: go could not build it; see $log"
    return 1
  fi
  rm -f "$log"
}
