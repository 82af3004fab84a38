# What failed in an ExUnit log: each failed test from its numbered title to the next line of another kind (at most 60 lines each, 20 tests).
# A log without one says why in its last lines: those are printed then, without the table of coverage.
/^  +[0-9]+\) / { if (++tests > 20) exit; lines = 0; printing = 1; print ""; }
/^(\.+|Finished in|Result: |Running ExUnit|==> )/ { printing = 0 }
printing && ++lines <= 60 { print }
!/^\|/ { last[++count] = $0 }
END {
  if (tests) exit
  print "no test of " suite " failed; its last lines:"
  for (i = count > 60 ? count - 59 : 1; i <= count; i++) print "  " last[i]
}
