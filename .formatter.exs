[
  inputs: [
    "mix.exs",
    "config/*.exs",
    "apps/project.exs",
    "packages/packages.exs",
    "{apps,packages}/*/{lib,test,bench}/**/*.{ex,exs}",
    "{apps,packages}/*/mix.exs",
    "{test,test_kit}/**/*.{ex,exs}",
    "bin/lib/checks/**/*.exs",
    "bin/lib/test_times.exs"
  ],
  line_length: 110,
  locals_without_parens: [
    # Aerie.Base.Settings
    setting: 3,
    setting: 4,
    section: 1,
    section: 2,
    part: 2,
    # Phoenix.Component and Phoenix.LiveView
    attr: 2,
    attr: 3,
    slot: 1,
    slot: 2,
    slot: 3,
    live: 2,
    live: 3,
    on_mount: 1,
    live_session: 3
  ]
]
