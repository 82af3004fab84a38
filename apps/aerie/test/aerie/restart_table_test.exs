defmodule Aerie.RestartTableTest do
  use ExUnit.Case, async: true

  @readme File.read!(Path.expand("../../README.md", __DIR__))

  # As the README calls them.
  defp name(module) do
    case module |> Module.split() |> Enum.take(-2) do
      ["Base", name] -> name
      names -> Enum.join(names, ".")
    end
  end

  test "the README's picture and its table of restarts have the children of a gateway in their order" do
    children =
      for {module, _options} <- Aerie.Gateway.parts(:readme, Aerie.Config.default()), do: name(module)

    picture = for [_all, name] <- Regex.scan(~r/G\d+\["\d+ ([A-Za-z.]+)/, @readme), do: name
    assert picture == children

    rows = for [_all, name] <- Regex.scan(~r/^\| ([A-Z][A-Za-z.]+) \|/m, @readme), do: name
    # The last one first: each row's cost includes those above it.
    assert Enum.filter(rows, &(&1 in children)) == Enum.reverse(children)
  end
end
