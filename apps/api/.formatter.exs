# As the root's; its own file lets Mix format one app.
{root, _binding} = Code.eval_file("../../.formatter.exs", __DIR__)
Keyword.put(root, :inputs, ["mix.exs", "{lib,test,bench}/**/*.{ex,exs}"])
