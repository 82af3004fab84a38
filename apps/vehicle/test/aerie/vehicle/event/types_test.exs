defmodule Aerie.Vehicle.Event.TypesTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Event.Types

  @readme Path.expand("../../../../lib/aerie/vehicle/README.md", __DIR__)

  test "the README shows the table as it is" do
    [before, rest] = @readme |> File.read!() |> String.split(~r/(?<=writes it -->\n)/, parts: 2)
    [shown, following] = String.split(rest, "<!-- /events -->", parts: 2)

    if System.get_env("GOLDEN") == "write",
      do: File.write!(@readme, [before, Types.markdown(), "<!-- /events -->", following]),
      else: assert(shown == Types.markdown())
  end
end
