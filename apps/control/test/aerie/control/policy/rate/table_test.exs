defmodule Aerie.Control.Policy.Rate.TableTest do
  use Aerie.GatewayCase, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Rate.Table

  test "each source has tokens of its own for each vehicle, and for raw MAVLink; one that is put back is there again" do
    gateway = start_gateway()
    {:ok, policy} = Policy.compile(%{rates: [%{types: ["goto"], per_minute: 1, burst: 1}]})
    take = fn kind, source, vehicle -> Table.take(gateway, policy, kind, source, vehicle, "goto") end
    assert take.(:command_rate, "olga", "VID-001") == :ok
    assert {:deny, :rate, "olga may command goto of VID-001" <> _} = take.(:command_rate, "olga", "VID-001")

    for {kind, source, vehicle} <- [
          {:rate, "olga", "VID-001"},
          {:command_rate, "otto", "VID-001"},
          {:command_rate, "olga", "VID-002"}
        ],
        do: assert(take.(kind, source, vehicle) == :ok)

    :ok = Table.put_back(gateway, policy, :command_rate, "olga", "VID-001", "goto")
    assert take.(:command_rate, "olga", "VID-001") == :ok
    assert {:deny, :rate, _text} = take.(:command_rate, "olga", "VID-001")
  end
end
