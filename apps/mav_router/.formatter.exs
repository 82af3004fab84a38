[inputs: ["mix.exs", "{lib,test,bench}/**/*.{ex,exs}"], line_length: 110, locals_without_parens: [setting: 3, setting: 4, section: 1, section: 2, part: 2]]
