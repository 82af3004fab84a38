defmodule Aerie.Control.Policy.Clients.ArmingTest do
  @moduledoc "A vehicle that asks before it arms (X13), through a link and a session."
  use Aerie.CommandCase, async: true

  import Aerie.Flight, only: [frame: 3]

  alias Aerie.Vehicle.Session.ArmAuthorization
  alias Aerie.Control.Policy.Clients.Arming
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Vehicle.Session.Core
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @key {"main", 7}

  defp decide(gateway), do: Arming.decide(gateway, Store.vehicle(gateway, @key), System.os_time(:microsecond))

  test "the policy decides, whatever the source of the command, and it is on record", %{tmp_dir: dir} do
    gateway = start_commands(dir, policy: [takeoff_battery: 0.5])
    # Its battery is not known.
    assert {:deny, :battery, reason} = decide(gateway)
    :ok = Policy.Store.put(gateway, %{})
    assert :allow = decide(gateway)

    eventually(fn ->
      match?(
        [%{"decision" => "deny", "rule" => "battery", "reason" => ^reason}, %{"decision" => "allow"}],
        for(%{"via" => "arm authorization"} = record <- audit(dir), do: record)
      )
    end)
  end

  test "where somebody has to be in charge, somebody has to be", %{tmp_dir: dir} do
    lease = %{required: true, take_over: :operator}
    gateway = start_commands(dir, policy: [lease: lease])
    assert {:deny, :lease, _reason} = decide(gateway)
    assert {:ok, _lease} = Holders.change(gateway, @key, {:take, nil, nil}, operator(), "rest", lease)
    assert :allow = decide(gateway)
  end

  test "it is answered at once that it is looked at, then with the decision, and only what is for us" do
    assert [%{command: 3001, result: 5, target_system: 1}, %{result: 0, result_param2: 10}] =
             ArmAuthorization.answers(:allow, 1, 1)

    assert [%{result: 5}, %{command: 3001, result: 1, target_component: 1}] =
             ArmAuthorization.answers({:deny, :battery, "low"}, 1, 1)

    beat = frame(%M.Heartbeat{type: 2, autopilot: 12, base_mode: 81}, 1_000_000, [])
    core = Core.new(Aerie.Flight.options(own_system: 245, own_component: 191))
    {core, _actions} = Core.handle(core, {:frames, "link", [beat]})

    asked = fn fields ->
      request = frame(struct!(%M.CommandLong{command: 3001}, fields), 2_000_000, [])
      {_core, actions} = Core.handle(core, {:frames, "link", [request]})
      for {:authorise_arming, from} <- actions, do: from
    end

    assert asked.(target_system: 245, target_component: 191) == [{1, 1}]
    assert asked.(target_system: 245, target_component: 0) == [{1, 1}]
    assert asked.(target_system: 255, target_component: 190) == []
    assert asked.(target_system: 245, target_component: 191, command: 400) == []
  end
end
