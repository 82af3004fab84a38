# What failed in an ExUnit log: each failed test from its numbered title to the next line of another kind (at most `most` lines each,
# 20 tests), without its log if `brief` is set. A log without one says why in its last lines: those are printed then, without the
# table of coverage.
/^  +[0-9]+\) / { if (++tests > 20) exit; lines = 0; printing = 1; print brief ? "FAILED: " suite ": " substr($0, index($0, ")") + 2) : ""; if (brief) next }
/^(\.+|Finished in|Result: |Running ExUnit|==> )/ { printing = 0 }
brief && /^ +The following output was logged/ { printing = 0 }
printing && (!brief || NF) && ++lines <= most { print }
!/^\|/ { last[++count] = $0 }
END {
  if (tests) exit
  print "no test of " suite " failed; its last lines:"
  for (i = count > most ? count - most + 1 : 1; i <= count; i++) print "  " last[i]
}
