defmodule Aerie.Fleet.AsyncAPI.RequestsTest do
  @moduledoc "What the schemas of requests take, the gateway takes, and the other way round; but for times, which are compared with a clock."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.AsyncAPI
  alias Aerie.Fleet.Operations
  alias Aerie.Fleet.Shadow.Update
  alias Aerie.{JsonSchemaCheck, JsonSchemaSample}
  alias Aerie.Vehicle.Command

  @now 1_795_000_000_000_000
  # Values that are somebody's first guess, and often wrong.
  @junk [nil, true, "", "a", "ä€😀", "a\0", 0, -1, 1.5, 1.0e40, 300, [], ["a"], [1], %{}, %{"a" => 1}]

  setup_all do
    %{document: JSON.decode!(AsyncAPI.text())}
  end

  defp both_ways(document, name, read, numtests) do
    schema = JsonSchemaCheck.component(document, name)

    for n <- 1..numtests do
      :rand.seed(:exsss, ExUnit.configuration()[:seed] + n)
      given = JsonSchemaSample.value(schema, document, Enum.random([:least, :some, :most]))
      assert {given, {:ok, _read}} = {given, read.(given)}

      for _n <- 1..5, odd = given |> changed() |> timeless(), match?({:ok, _read}, read.(odd)) do
        assert {odd, []} == {odd, JsonSchemaCheck.errors(schema, odd, document)}
      end
    end
  end

  # One part is another, is left out, or is added.
  defp changed(%{} = object) when map_size(object) > 0 do
    key = object |> Map.keys() |> Enum.random()

    case :rand.uniform(5) do
      1 ->
        Map.delete(object, key)

      2 ->
        Map.put(
          object,
          Enum.random(["extra", "version", "tag", "mode", "FENCE_ALT_MAX", "ATTITUDE", "x y"]),
          Enum.random(@junk)
        )

      3 ->
        Map.put(object, key, Enum.random(@junk))

      _deeper ->
        Map.update!(object, key, &changed/1)
    end
  end

  defp changed([_ | _] = list), do: List.update_at(list, :rand.uniform(length(list)) - 1, &changed/1)
  defp changed(_leaf), do: Enum.random(@junk)

  defp timeless(object), do: Map.drop(object, ["issued_at", "deadline", "expires_at"])

  test "a change of the desired state", %{document: document} do
    now = System.os_time(:microsecond)
    # Over NATS it must name its version.
    read = &if(is_integer(&1["version"]), do: Update.parse(&1, now), else: :no_version)
    both_ways(document, "shadow.update", read, 100)

    both_ways(
      document,
      "shadow.delete",
      &if(is_integer(&1["version"]), do: Update.parse_delete(&1, now), else: :no_version),
      50
    )
  end

  test "an operation", %{document: document} do
    now = System.os_time(:microsecond)
    read = &if(is_map_key(&1, "id"), do: Operations.Request.parse(&1, now), else: :no_id)
    both_ways(document, "operation.begin", read, 60)
  end

  for type <- Command.Types.names() do
    test "the command #{type}", %{document: document} do
      read = fn object ->
        envelope = object |> timeless() |> Map.put_new("source", "tests")
        # The subject names both.
        named = Map.merge(envelope, %{"vehicle" => "V", "type" => unquote(type)})
        vehicle? = match?(%{"vehicle" => odd} when not is_binary(odd) and odd != nil, object)

        right? =
          object["type"] in [nil, unquote(type)] and not vehicle? and Command.token?(object["vehicle"] || "V")

        if right?, do: Command.parse(named, @now), else: :another
      end

      both_ways(document, "command.#{unquote(type)}", read, 15)
    end
  end

  test "times", %{document: document} do
    schema = JsonSchemaCheck.component(document, "moment")
    at = DateTime.to_iso8601(DateTime.from_unix!(@now, :microsecond))
    seconds = div(@now, 1_000_000)

    for {time, right?} <- [
          {at, true},
          {String.replace(at, "Z", "+00:00"), true},
          {at |> String.replace("T", " ") |> String.replace("Z", "123Z"), true},
          {"2026-11-18T11:46:40", false},
          {"2026-11-18T11:46:60Z", false},
          {"2026-02-30T11:46:40Z", false},
          {"2026-11-18T11:46:40-00:00", false},
          {seconds, true},
          {seconds * 1000, false},
          {0, false},
          {nil, false},
          {"soon", false}
        ] do
      assert JsonSchemaCheck.errors(schema, time, document) == [] == right?, inspect(time)

      command = %{"id" => "a", "vehicle" => "V", "type" => "rtl", "source" => "s", "deadline" => time}
      # In the past it is a deadline that has passed, and no error.
      if time != nil,
        do: assert(match?({:ok, _command}, Command.parse(command, @now)) == right?, inspect(time))
    end
  end
end
