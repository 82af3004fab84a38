defmodule Aerie.Config.RecipesTest do
  @moduledoc "The pieces of configuration in docs/hub.md and the guides are ones that the gateway takes; the commands of the guides exist."
  use ExUnit.Case, async: true

  alias Aerie.Config
  alias MavRouter.Endpoints.Owner.RuleKeys

  @moduletag :tmp_dir
  @docs Path.expand("../../../../../docs", __DIR__)
  @guides Path.wildcard(Path.join(@docs, "guides/*.md"))
  @pages [Path.join(@docs, "hub.md") | @guides]
  for page <- @pages, do: @external_resource(page)

  @blocks fn page, language ->
    for [_all, ^language, text] <- Regex.scan(~r/^```(\w*)\n(.*?)^```$/ms, File.read!(page)), do: text
  end
  @recipes for page <- @pages,
               {recipe, n} <- Enum.with_index(@blocks.(page, "yaml"), 1),
               do: {Path.basename(page), n, recipe}
  @calls for page <- @guides,
             block <- @blocks.(page, ""),
             line <- block |> String.replace(~r/ \\\n */, " ") |> String.split("\n", trim: true),
             do: {Path.basename(page), line}

  test "there are some" do
    assert length(@recipes) >= 10
    assert length(@calls) >= 8
  end

  for {page, n, recipe} <- @recipes do
    test "#{page}, recipe #{n}", %{tmp_dir: dir} do
      path = Path.join(dir, "gateway.yaml")
      File.write!(path, unquote(recipe))
      assert {:ok, config} = Config.load(path, [], env: %{})
      for %{} = link <- config.links, do: assert({:ok, _options} = RuleKeys.owner_options(link))
      clients = if config.clients == :default, do: [], else: config.clients
      for client <- clients, do: assert({:ok, _spec} = MavRouter.Client.Settings.client(client))
    end
  end

  # A script of the checkout, a command of `bin/aerie`, or a program of the system that is named here.
  for {{page, line}, n} <- Enum.with_index(@calls, 1) do
    test "#{page}, call #{n}: #{line}" do
      case unquote(line) |> String.replace(~r/\Asudo (-u aerie )?/, "") |> String.split() do
        ["bin/" <> script | options] ->
          assert {help, 0} =
                   System.cmd(Path.join([@docs, "../bin", script]), ["--help"], stderr_to_stdout: true)

          for "--" <> _ = option <- options, do: assert(help =~ option)

        ["aerie" | words] ->
          parses(words)

        ["docker", "exec", _container, "aerie" | words] ->
          parses(words)

        ["docker", "compose", "exec", "gateway", "aerie" | words] ->
          parses(words)

        # Its entrypoint in rel/container/compose.yaml.
        ["docker", "compose", "run", "--rm", "setup" | words] ->
          parses(["nats-setup", "/fleet" | words])

        ["mix", task | _arguments] ->
          assert Mix.Task.get(task)

        [program | _arguments] ->
          assert program in ~w(apt systemctl install cd docker printf echo)
      end
    end
  end

  defp parses(words),
    do: assert({:ok, _subcommand, _arguments, _options} = Aerie.CLI.Parser.command_line(words))
end
