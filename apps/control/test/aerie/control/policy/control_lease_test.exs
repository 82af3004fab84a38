defmodule Aerie.Control.Policy.ControlLeaseTest do
  use Aerie.GatewayCase, async: true

  alias Aerie.Control.Policy
  alias Aerie.Vehicle.Command
  alias Aerie.Control.Policy.ControlLease
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Base.PubSub

  @now 1_795_000_000_000_000
  @olga %{name: "olga", role: :operator, permissions: []}
  @omar %{name: "omar", role: :operator, permissions: []}
  @ada %{name: "ada", role: :admin, permissions: []}
  @rules %{required: false, take_over: :operator}
  @key {"main", 1}

  defp change(lease, change, source, rules \\ @rules),
    do: ControlLease.change(lease, change, source, "rest", rules, @now)

  defp lease(fields \\ []),
    do: struct!(%ControlLease{holder: "olga", via: "rest", since: @now - 60_000_000}, fields)

  test "who may take, offer and release it" do
    assert {:ok, %ControlLease{holder: "olga", via: "rest", since: @now, before: nil}} =
             change(nil, {:take, nil, nil}, @olga)

    # Again: since then, and no longer offered.
    assert change(lease(offered_to: "omar"), {:take, nil, nil}, @olga) == {:ok, lease()}

    assert {:deny, :lease, "olga is in charge of the vehicle (since " <> rest} =
             change(lease(), {:take, nil, nil}, @omar)

    assert rest =~ "taking over needs a reason"

    assert {:ok, %{holder: "omar", before: "olga", reason: "lost her"}} =
             change(lease(), {:take, "lost her", nil}, @omar)

    assert change(lease(), {:offer, "omar"}, @olga) == {:ok, lease(offered_to: "omar")}
    assert {:deny, :lease, _} = change(lease(), {:offer, "omar"}, @omar)
    assert {:ok, %{holder: "omar", reason: nil}} = change(lease(offered_to: "omar"), {:take, nil, nil}, @omar)
    assert {:deny, :lease, _} = change(lease(offered_to: "omar"), {:take, nil, nil}, @ada)
    assert {:ok, %{holder: "ada"}} = change(lease(offered_to: :anyone), {:take, nil, nil}, @ada)

    admins = %{@rules | take_over: :admin}
    assert {:deny, :lease, reason} = change(lease(), {:take, "lost her", nil}, @omar, admins)
    assert reason =~ "only an admin may take over"
    assert {:ok, %{holder: "ada"}} = change(lease(), {:take, "lost her", nil}, @ada, admins)

    assert change(lease(), :release, @olga) == {:ok, nil}
    assert change(lease(), :release, @ada) == {:ok, nil}
    assert {:deny, :lease, _} = change(lease(), :release, @omar)
    assert change(nil, :release, @ada) == {:deny, :lease, "nobody is in charge"}
  end

  test "the rule: one commands; what holds it or brings it down, and asking for messages, is free" do
    for {required, in_charge, type, params, expected} <- [
          {false, nil, "arm", %{}, :allow},
          {false, "olga", "arm", %{}, :allow},
          {false, "omar", "arm", %{}, :lease},
          {false, "omar", "gripper", %{action: "release"}, :lease},
          {false, "omar", "rtl", %{}, :allow},
          {false, "omar", "set_mode", %{mode: "BRAKE"}, :allow},
          {false, "omar", "set_mode", %{mode: "GUIDED"}, :lease},
          {false, "omar", "request_message", %{message_id: 33}, :allow},
          {false, "omar", "take_control", %{}, :lease},
          {false, "omar", "take_control", %{reason: "he is asleep"}, :allow},
          {false, "omar", "release_control", %{}, :lease},
          {true, nil, "arm", %{}, :lease},
          {true, nil, "land", %{}, :allow},
          {true, nil, "take_control", %{}, :allow},
          {true, "olga", "arm", %{}, :allow}
        ] do
      {:ok, policy} = Policy.compile(%{lease: %{required: required}})
      {:ok, command} = Command.new([vehicle: "V", type: type, params: params], @now)
      lease = if in_charge, do: lease(holder: in_charge)
      decision = Policy.decide(policy, command, %Context{source: @olga, now: @now, lease: lease})
      rule = with {:deny, rule, reason} when is_binary(reason) <- decision, do: rule
      assert {required, in_charge, type, params, rule} == {required, in_charge, type, params, expected}
    end
  end

  test "if many take it at once, one is in charge, and all watchers hear of it" do
    gateway = start_gateway()
    :ok = PubSub.subscribe(gateway, :leases)

    taken =
      1..20
      |> Task.async_stream(
        fn n ->
          source = %{@olga | name: "source-#{n}"}
          {source.name, Holders.change(gateway, @key, {:take, nil, nil}, source, "rest", @rules)}
        end,
        timeout: Aerie.Patience.ms()
      )
      |> Enum.flat_map(fn {:ok, {name, answer}} -> if match?({:ok, _lease}, answer), do: [name], else: [] end)

    assert [name] = taken
    assert %ControlLease{holder: ^name} = lease = Holders.of(gateway, @key)
    assert_receive {:fleet, :leases, {@key, ^lease}}
    source = %{@olga | name: name}
    # What changes nothing is told to nobody.
    assert {:ok, ^lease} = Holders.change(gateway, @key, {:take, nil, nil}, source, "rest", @rules)
    assert {:ok, offered} = Holders.change(gateway, @key, {:offer, :anyone}, source, "rest", @rules)
    assert Holders.all(gateway) == %{@key => offered}
    assert_receive {:fleet, :leases, {@key, ^offered}}
    assert {:ok, nil} = Holders.change(gateway, @key, :release, source, "rest", @rules)
    assert_receive {:fleet, :leases, {@key, nil}}
    assert Holders.of(gateway, @key) == nil
  end
end
