# System tests run with apps/aerie's own, which depends on every app (see its mix.exs).
# Ground stations written in Python need the environment that bin/setup makes.
ExUnit.start(exclude: [:long, :soak] ++ Aerie.PeerCase.missing() ++ Aerie.Browser.excluded())
Aerie.PeerCase.say_missing()
