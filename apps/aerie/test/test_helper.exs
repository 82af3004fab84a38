# Long suites run with `bin/test --full`, hour-long ones with `bin/test --soak`.
# Ground stations written in Python need the environment that bin/setup makes.
ExUnit.start(exclude: [:long, :soak] ++ Aerie.PeerCase.missing() ++ Aerie.Browser.excluded())
