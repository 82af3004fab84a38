defmodule Aerie.Control.Policy.ControlLease.SteeringTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Store
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Aerie.Control.Policy.ControlLease.Steering
  alias Aerie.Base.Principal

  @steers ~w(arm set_mode rtl hold manual_control rc_override)

  setup do
    gateway = :"steering_#{System.unique_integer([:positive])}"
    start_supervised!({Store, gateway: gateway, tables: [ClientHistory.table()]})
    {:ok, gateway: gateway}
  end

  defp vehicle(autopilot \\ :betaflight, system \\ 7), do: %{autopilot: autopilot, key: {"main", system}}
  defp key(name), do: %Principal{kind: :key, name: name, role: :operator}

  # Two ground stations of one client, each a program of its own.
  defp station(port),
    do: %Principal{kind: :client, name: "laptop", role: :operator, program: "laptop 127.0.0.1:#{port}"}

  defp claim(c, type, source, vehicle \\ vehicle()),
    do: Steering.claim(c.gateway, vehicle, Intent.named(type), source)

  # The rows of the table, as they would be when so many seconds have passed.
  defp later(c, seconds) do
    table = Store.table!(c.gateway, :client_history)

    for {{:steering, :steers, _} = key, value, until} <- :ets.tab2list(table),
        do: :ets.insert(table, {key, value, until - seconds * 1_000_000})
  end

  test "one principal steers: not another key, user or program, whatever it asks for, and the refusal names the first",
       c do
    for {first, second, named} <- [
          {key("olga"), key("omar"), "olga"},
          {key("olga"), %{key("olga") | kind: :user}, "olga"},
          {station(1), station(2), "laptop 127.0.0.1:1"},
          {key("olga"), %{name: "shadow", role: :admin, permissions: []}, "olga"}
        ],
        firmware <- [:betaflight, :inav],
        began <- @steers,
        type <- @steers do
      vehicle = vehicle(firmware, System.unique_integer([:positive]))
      assert claim(c, began, first, vehicle) == :allow
      assert claim(c, type, first, vehicle) == :allow
      assert {:deny, :lease, reason} = claim(c, type, second, vehicle)
      assert reason =~ "#{named} steers it"
    end
  end

  test "it may be disarmed by others, which ends it", c do
    for type <- ~w(disarm force_disarm) do
      assert claim(c, "manual_control", key("olga")) == :allow
      assert claim(c, type, key("omar")) == :allow
      assert claim(c, "arm", key("omar")) == :allow
      assert {:deny, :lease, _} = claim(c, "manual_control", key("olga"))
      assert claim(c, type, key("olga")) == :allow
    end
  end

  test "it ends with what the vehicle's session waits for, and a mode makes it no longer than that", c do
    for {type, seconds} <- [{"manual_control", 1.1}, {"rc_override", 1.1}, {"set_mode", 10.1}, {"arm", 18.1}] do
      assert claim(c, type, key("olga")) == :allow
      later(c, round(seconds - 1))
      assert {:deny, :lease, _} = claim(c, "manual_control", key("omar"))
      later(c, 2)
      assert claim(c, "disarm", key("omar")) == :allow
    end

    assert claim(c, "manual_control", key("olga")) == :allow
    assert claim(c, "set_mode", key("olga")) == :allow
    later(c, 2)
    assert claim(c, "manual_control", key("omar")) == :allow
  end

  test "sticks that the gateway repeats count for as long", c do
    assert Steering.claim(c.gateway, vehicle(), Intent.named("manual_control"), key("olga"), 5_000_000) ==
             :allow

    later(c, 4)
    assert {:deny, :lease, _} = claim(c, "manual_control", key("omar"))
    later(c, 3)
    assert claim(c, "manual_control", key("omar")) == :allow
  end

  test "other vehicles, other commands and other firmwares have nothing of it", c do
    assert claim(c, "arm", key("olga")) == :allow
    assert claim(c, "arm", key("omar"), vehicle(:betaflight, 8)) == :allow
    assert claim(c, "reboot", key("omar")) == :allow

    for vehicle <- [vehicle(:ardupilot, 9), vehicle(:px4, 9), nil],
        source <- [key("olga"), key("omar")],
        do: assert(claim(c, "arm", source, vehicle) == :allow)
  end
end
