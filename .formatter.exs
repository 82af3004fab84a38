[
  inputs: ["mix.exs", "config/*.exs", "packages/packages.exs", "{apps,packages}/*/{lib,test,bench}/**/*.{ex,exs}", "{apps,packages}/*/mix.exs"],
  line_length: 110
]
