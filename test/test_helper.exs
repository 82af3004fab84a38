# System tests run with apps/aerie_cli's own, which depends on every app (see its mix.exs).
ExUnit.start(exclude: [:long, :soak])
