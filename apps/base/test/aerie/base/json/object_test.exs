defmodule Aerie.Base.Json.ObjectTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Json.Object

  @peer Object.fields([{:name, :text, nil, "its name"}, {:silent_s, {:seconds, 1}, "s", "its silence", :us}])
  @fields Object.fields([
            {:state, {:one_of, [:up, :down]}, nil, "what it is"},
            {:volts, 2, "V", "the voltage"},
            {:whole, 0, nil, "a whole number"},
            {:since, :time, nil, "since when", :at},
            {:peers, {:list, {:object, @peer}}, nil, "the others:"},
            {:counts, {:map, :integer}, nil, "by name"},
            {:first, :any, nil, "the first of them", &__MODULE__.first/1}
          ])

  def first(value), do: value |> Map.get(:list, []) |> List.first()

  test "shows what is declared and nothing else, rounded, with times as text and unknown values as null" do
    value = %{
      state: :up,
      volts: 12.3456,
      whole: 3.7,
      at: 1_700_000_000_123_456,
      peers: [%{name: <<255>>, us: 1_250_000, secret: "x"}],
      counts: %{"a" => 1},
      list: [{1, 2}],
      secret: "x"
    }

    assert Object.show(@fields, value) == %{
             state: :up,
             volts: 12.35,
             whole: 4,
             since: "2023-11-14T22:13:20.123Z",
             peers: [%{name: "\uFFFD", silent_s: 1.3}],
             counts: %{"a" => 1},
             first: "{1, 2}"
           }

    unknown = Object.show(@fields, %{volts: {:nan, 1}})
    assert Enum.sort(Map.keys(unknown)) == Enum.sort(Enum.map(@fields, & &1.name))
    assert Enum.all?(Map.values(unknown), &(&1 == nil))
  end

  test "has a schema of all fields, with meaning and unit" do
    schema = Object.schema(@fields)
    assert Enum.sort(schema.required) == Enum.sort(Enum.map(@fields, & &1.name))
    assert schema.properties.volts == %{type: [:number, :null], description: "the voltage (V)"}
    assert schema.properties.state == %{enum: [:up, :down, nil], description: "what it is"}
    assert schema.properties.first == %{description: "the first of them"}
    assert %{items: %{properties: %{name: %{description: "its name"}}}} = schema.properties.peers
    assert %{additionalProperties: %{type: :integer}} = schema.properties.counts
  end

  test "has rows for a table, those of objects below it with dots" do
    names = for {name, _unit, _meaning} <- Object.rows(@fields), do: name

    assert names ==
             ~w(state volts whole since peers peers.name peers.silent_s counts first)

    assert {"peers.silent_s", "s", "its silence"} in Object.rows(@fields)
  end
end
