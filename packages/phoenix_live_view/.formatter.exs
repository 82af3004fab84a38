[
  inputs: ["mix.exs", "{lib,test,bench}/**/*.{ex,exs}"],
  line_length: 110,
  locals_without_parens: [attr: 2, attr: 3, slot: 1, slot: 2, slot: 3, live: 2, live: 3, on_mount: 1, live_session: 3]
]
