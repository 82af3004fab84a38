[
  inputs: ["mix.exs", "config/*.exs", "packages/packages.exs", "{apps,packages}/*/{lib,test,bench}/**/*.{ex,exs}", "{apps,packages}/*/mix.exs", "test/**/*.{ex,exs}"],
  line_length: 110
]
