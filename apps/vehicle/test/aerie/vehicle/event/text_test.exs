defmodule Aerie.Vehicle.Event.TextTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Event.Text

  defp event(type, data), do: Event.new("VID-001", type, 1, 0, nil, data)

  test "each type of event has a text, whatever of its data is missing" do
    for %{type: type, fields: fields} <- Event.Types.all() do
      assert %{text: text} = Text.of(event(type, %{}))
      assert is_binary(text)
      assert Text.of(event(type, Map.new(fields, &{&1.name, nil}))).text =~ ~r/\w|^$/u
    end
  end

  test "a text leaves out what is not known, and takes values as they are" do
    for {type, data, text} <- [
          {"mission.reached", %{"seq" => 3, "total" => 8}, "item 3 of 8 reached"},
          {"mission.reached", %{"seq" => 3}, "item 3 reached"},
          {"armed", %{"reason" => "rc_switch"}, "armed (rc switch)"},
          {"armed", %{}, "armed"},
          {"gcs.lost", %{"system" => 255}, "ground station 255 lost"},
          {"signing.failed", %{"reason" => "no_answer", "by" => "ann_b"},
           "signing key not changed (no answer) by ann_b"},
          {"param_changed", %{"name" => "A_{to}", "from" => nil, "to" => 1.5}, "A_{to}: unknown → 1.5"},
          {"link.lost", %{"silent_s" => 10.4}, "contact lost for 10 s"},
          {"battery.low", %{"remaining" => 0.2, "voltage" => 11.1}, "battery low: 20 %"},
          {"battery.low", %{"voltage" => 11.1}, "battery low: 11.1 V"}
        ],
        do: assert(Text.of(event(type, data)).text == text)
  end
end
