defmodule Aerie.Fleet.TelemetryTest do
  use ExUnit.Case, async: true

  # Names of telemetry events as they stand in the source and in the documentation.
  @emitted ~r/:telemetry\.(?:execute|span)\(\s*(\[:aerie[^\]]*\])/
  @written ~r/`(\[:aerie[^\]]*\])`/

  # A name with a variable in it is that of several events, which the documentation spells out.
  defp names(pattern, text) do
    for [_, list] <- Regex.scan(pattern, text),
        parts =
          list
          |> String.trim("[")
          |> String.trim("]")
          |> String.split(",", trim: true)
          |> Enum.map(&String.trim/1),
        Enum.all?(parts, &String.starts_with?(&1, ":")),
        do: Enum.map(parts, &String.trim_leading(&1, ":"))
  end

  defp contract,
    do: for({name, _module} <- Aerie.Fleet.Telemetry.events(), do: Enum.map(name, &Atom.to_string/1))

  test "every event that is emitted is in the contract" do
    source =
      Path.wildcard(Path.expand("../../../../vehicle/lib/**/*.ex", __DIR__))
      |> Enum.map_join("\n", &File.read!/1)

    assert names(@emitted, source) -- contract() == []
  end

  test "every event of the contract is documented where it says" do
    for {name, module} <- Aerie.Fleet.Telemetry.events() do
      {:docs_v1, _, _, _, %{"en" => text}, _, _} = Code.fetch_docs(module)

      assert Enum.map(name, &Atom.to_string/1) in names(@written, text),
             "#{inspect(name)} is not in #{inspect(module)}"
    end
  end
end
