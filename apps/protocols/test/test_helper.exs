Aerie.Patience.load_code()

# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`; peers written in Python need the
# environment that bin/setup makes, the other ends of serial cables a C compiler.
# Most tests wait for vehicles and servers rather than compute, so more of them run at once than there are cores.
ExUnit.start(
  max_cases: Aerie.Patience.cases(),
  exclude:
    [:long, :soak] ++
      if(Aerie.PythonPeer.python(), do: [], else: [:python]) ++
      if(Aerie.SerialPeer.build(), do: [], else: [:pty])
)
