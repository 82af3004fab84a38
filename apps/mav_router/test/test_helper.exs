Aerie.Patience.load_code()

# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`; peers written in Python need the
# environment that bin/setup makes, the other ends of serial cables a C compiler.
ExUnit.start(
  exclude:
    [:long, :soak] ++
      if(Aerie.PythonPeer.python(), do: [], else: [:python]) ++
      if(Aerie.SerialPeer.build(), do: [], else: [:pty])
)
