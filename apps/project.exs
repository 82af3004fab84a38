Code.require_file("../packages/packages.exs", __DIR__)

# What the mix.exs of all applications have in common.
defmodule Aerie.Project do
  # What the tests are made of is not what they test.
  @support ~r/^Aerie\.(?!Vehicle|Control|Fleet|Base)\w+$|Case$/

  # `own`: keys of the project that are not those of all. `:support` says where modules of the tests are.
  def of(app, own) do
    {support, own} = Keyword.pop(own, :support, ["test/support"])

    Keyword.merge(
      [
        app: app,
        version: "0.1.0",
        build_path: "../../_build",
        config_path: "../../config/config.exs",
        deps_path: "../../deps",
        lockfile: "../../mix.lock",
        elixir: "~> 1.20",
        elixirc_paths: if(Mix.env() == :test, do: ["lib" | support], else: ["lib"]),
        # The body of a module runs once. To compile it for that took a third of the time that a message's module takes.
        elixirc_options: [module_definition: :interpreted],
        test_coverage: [summary: [threshold: 85], ignore_modules: [@support]],
        test_ignore_filters: [~r"/support/", ~r"/fixtures/"]
      ],
      own
    )
  end

  # Applications of Erlang and Elixir. PropEr is Debian's, not a dependency that Mix knows; naming it keeps it on the
  # code path of the tests.
  def application(used, in_tests \\ [:proper], own \\ []),
    do: [extra_applications: if(Mix.env() == :test, do: used ++ in_tests, else: used)] ++ own
end
