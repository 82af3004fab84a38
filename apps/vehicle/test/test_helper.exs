# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`; peers written in Python need the
# environment that bin/setup makes, the other ends of serial cables a C compiler.
#
# A message that is awaited comes, if at all, at once, and no test takes half a minute; the patience is for machines that are
# busy with something else.
ExUnit.start(
  exclude:
    [:long, :soak] ++
      if(Aerie.PythonPeer.python(), do: [], else: [:python]) ++
      if(Aerie.SerialPeer.build(), do: [], else: [:pty]),
  assert_receive_timeout: 10_000,
  timeout: 300_000
)
