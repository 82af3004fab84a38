defmodule Aerie.Vehicle.Services.Reports.DefinitionsTest do
  @moduledoc "What a vehicle says about its own events (X3, X14)."
  use ExUnit.Case, async: true

  import Bitwise

  alias Aerie.Vehicle.Services.Reports.{Definitions, Names}

  @gcs_lost 0x01A4B458
  @new 0x01000001

  defp file(events, enums \\ %{}, version \\ 2) do
    group = %{"events" => Map.new(events, fn {id, event} -> {to_string(id), event} end)}
    component = %{"namespace" => "px4", "enums" => enums, "event_groups" => %{"default" => group}}
    JSON.encode!(%{"version" => version, "components" => %{"1" => component}})
  end

  defp event(name, types \\ []),
    do: %{
      "name" => name,
      "message" => "Text {1}",
      "arguments" => for(type <- types, do: %{"type" => type, "name" => "x"})
    }

  defp own(text) do
    assert {:ok, definitions} = Definitions.decode(text)
    Names.own(definitions)
  end

  test "wins over Aerie's own file, which knows the others" do
    mode = %{
      "type" => "uint8_t",
      "entries" => %{
        "3" => %{"name" => "hover", "description" => "Stays."},
        "x" => %{"name" => "y"},
        "999" => %{"name" => "z"}
      }
    }

    flags = %{"type" => "uint16_t", "is_bitfield" => true, "entries" => %{"2" => %{"name" => "two"}}}

    own =
      %{
        (@gcs_lost &&& 0xFFFFFF) => event("commander_gcs_lost", ["uint16_t", "mode_t"]),
        1 => event("newer_than_aerie", ["px4::flags_t", "int8_t"])
      }
      |> file(%{"mode_t" => mode, "flags_t" => flags})
      |> own()

    assert Names.values(@gcs_lost, <<0, 1, 3>>) == []
    assert Names.values(own, @gcs_lost, <<0, 1, 3>>) == [256, "hover"]
    assert Names.values(own, @gcs_lost, <<0, 1, 4>>) == [256, 4]
    assert Names.name(own, @gcs_lost) == "commander_gcs_lost"
    assert {Names.name(@new), Names.name(own, @new)} == {nil, "newer_than_aerie"}
    assert Names.values(own, @new, <<2, 0, 0xFF>>) == [["two"], -1]
    # What the vehicle does not describe.
    assert Names.name(own, 0x01414569) == "commander_takeoff_detected"
    assert Names.values(own, 1103, <<1>>) == ["failed"]
  end

  test "only what is otherwise than in Aerie's own file is kept" do
    assert own(file(%{(@gcs_lost &&& 0xFFFFFF) => event("commander_gcs_lost")})) == Definitions.none()
  end

  test "an event keeps its bytes if an argument has an unknown type, or a message has no room for all" do
    for types <- [
          ["px4::unknown_t"],
          ["uint64_t"] |> List.duplicate(6) |> List.flatten(),
          [nil],
          [7],
          ["double"]
        ] do
      own = own(file(%{1 => event("newer", types)}))
      assert {Names.name(own, @new), Names.values(own, @new, <<1, 2>>)} == {"newer", nil}
    end

    own = own(file(%{1 => event("newer", List.duplicate("uint64_t", 5))}))
    assert Names.values(own, @new, <<1>>) == [1, 0, 0, 0, 0]
  end

  test "what is not as MAVLink has it is refused, or left out" do
    wrong = ["", "[]", "{", ~s({"version": 2, "components": []}), ~s({"components": {}})]

    for bad <- wrong ++ [file(%{}, %{}, 3), file(%{}, %{}, %{})] do
      assert {:error, "the events' metadata " <> _why} = Definitions.decode(bad)
    end

    for odd <- [
          ~s({"version": 1, "components": {"1": 5}}),
          ~s({"version": 1, "components": {"x": {"event_groups": {"a": {"events": {"1": {"name": "n"}}}}}}}),
          ~s({"version": 1, "components": {"1": {"enums": [], "event_groups": {"a": [], "b": {"events": 7}}}}}),
          ~s({"version": 1, "components": {"1": {"enums": {"a": {"type": "float"}, "b": 6}, "namespace": 7}}}),
          file(%{
            "x" => event("n"),
            16_777_216 => event("n"),
            -1 => event("n"),
            2 => 5,
            3 => %{},
            4 => event(7),
            5 => event("")
          })
        ],
        do: assert(Definitions.decode(odd) |> elem(1) |> Map.fetch!(:events) == %{})
  end

  test "has bounds" do
    many = Map.new(1..2_001, &{&1, event("e#{&1}")})
    assert {:error, "the metadata describes 2001 events" <> _} = Definitions.decode(file(many))
    entries = Map.new(0..4_000, &{to_string(&1), %{"name" => "v#{&1}"}})
    enum = %{"type" => "uint32_t", "entries" => entries}
    assert {:error, "the events' enums have 4001 values" <> _} = Definitions.decode(file(%{}, %{"a" => enum}))
    assert own(file(%{1 => event(String.duplicate("x", 101))})) == Definitions.none()
  end

  test "whatever bytes come: they are read, or refused" do
    json =
      file(%{1 => event("a", ["uint8_t", "mode_t"])}, %{
        "mode_t" => %{"type" => "uint8_t", "entries" => %{"1" => %{"name" => "b"}}}
      })

    property =
      :proper.forall({:proper_types.range(0, byte_size(json) - 1), :proper_types.range(32, 126)}, fn {at,
                                                                                                      byte} ->
        <<before::binary-size(^at), _one, rest::binary>> = json

        case Definitions.decode(before <> <<byte>> <> rest) do
          {:ok, definitions} ->
            own = Names.own(definitions)
            values = Names.values(own, @new, <<1, 2>>)
            values == nil or is_list(values)

          {:error, why} ->
            is_binary(why)
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 1_000]) == true, inspect(:proper.counterexample())
  end
end
