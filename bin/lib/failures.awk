# What failed in an ExUnit log: each failed test from its numbered title to the next line of another kind (its first and last `most`
# lines, 20 tests), without its log if `brief` is set. A log without one says why in its last lines: those are printed then, without the
# table of coverage.
function flush_test(  i, from) {
  from = lines - most + 1
  if (from > most + 1) print "     …"
  for (i = from > most ? from : most + 1; i <= lines; i++) print kept[i]
  lines = 0
}
/^  +[0-9]+\) / { flush_test(); if (++tests > 20) exit; printing = 1; print brief ? "FAILED: " suite ": " substr($0, index($0, ")") + 2) : ""; if (brief) next }
/^(\.+|Finished in|Result: |Running ExUnit|==> )/ { printing = 0 }
brief && /^ +The following output was logged/ { printing = 0 }
printing && (!brief || NF) { kept[++lines] = $0; if (lines <= most) print }
!/^\|/ { last[++count] = $0 }
END {
  if (tests <= 20) flush_test()
  if (tests) exit
  print "no test of " suite " failed; its last lines:"
  for (i = count > most ? count - most + 1 : 1; i <= count; i++) print "  " last[i]
}
