defmodule Aerie.Fleet.Operations.ReturningTest do
  @moduledoc "The steps of vehicles that return together, and what they wait for."
  use ExUnit.Case, async: true

  alias Aerie.Base.Store
  alias Aerie.Fleet.Operations.Sequence
  alias Aerie.Fleet.Operations.Sequence.{Ending, Returning, Wait}
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.Snapshot

  defp words(vehicle) do
    {:ok, [%{steps: steps}]} = Sequence.parse([vehicle], 1, 0)
    for step <- steps, do: {Sequence.word(step), step}
  end

  test "to its height first, and where another one lands there, after that" do
    assert [{"set_altitude", _command}, {"wait_at", {:wait, %{m: 30, go_on?: false}}}, {"rtl", _home}] =
             words(Returning.steps("V-1", 30, nil))

    steps = words(Returning.steps("V-2", 33, "V-1"))
    assert for({word, _step} <- steps, do: word) == ~w(set_altitude wait_at wait_turn wait_time rtl)
    # Time enough for the way down from 400 m.
    assert {:wait, %{for: :at, timeout_ms: 300_000}} = steps |> Enum.at(1) |> elem(1)
    assert {:wait, %{for: :landed, of: "V-1", go_on?: false}} = steps |> Enum.at(2) |> elem(1)
    # What waits for a time goes on when it is over.
    assert {:wait, %{for: :time, timeout_ms: 15_000, go_on?: true}} = steps |> Enum.at(3) |> elem(1)
    assert [{"rtl", _home}] = words(Returning.steps("V-3", nil, nil))
  end

  test "a take-off has a second more for each metre that the next one waits for" do
    seen = %Snapshot{id: "V-1", autopilot: :px4, groups: %{mode: %{at: 0, data: %{mode: "AUTO_LOITER"}}}}

    for {above, seconds} <- [{5, 65}, {99.5, 159.5}],
        do:
          assert(
            %{"wait" => "above", "m" => ^above, "timeout_s" => ^seconds} =
              List.last(Sequence.take_off(seen, 100, above)["steps"])
          )
  end

  test "a height is reached from below and from above, a time never by itself" do
    at = fn height ->
      seen = %Snapshot{id: "V-1", groups: %{position: %{at: 0, data: %{alt_rel: height}}}}
      Wait.look(%{for: :at, m: 30, of: nil}, seen, [])
    end

    assert [at.(29), at.(30.5), at.(31)] == [:ok, :ok, :ok]
    assert {:waiting, "50 m high, not at 30 m", "V-1"} = at.(50)
    assert {:waiting, "29 m high, not at 30 m", "V-1"} = at.(28.9)
    assert {:waiting, "its height is not known", "V-1"} = at.(nil)
    assert {:waiting, _why, "V-1"} = Wait.look(%{for: :time, of: nil}, %Snapshot{id: "V-1"}, [])
  end

  test "a landing of another one is looked for at that one" do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})

    put = fn id, n, in_air ->
      groups = %{mode: %{at: 0, data: %{in_air: in_air}}}

      Store.put_vehicle(gateway, {"main", n}, %Snapshot{
        id: id,
        key: {"main", n},
        network: "main",
        system_id: n,
        status: :online,
        groups: groups
      })
    end

    wait = %{for: :landed, m: nil, of: "V-1", timeout_ms: 1, go_on?: false}
    put.("V-2", 2, true)
    assert {:waiting, "nobody hears it", "V-1"} = Wait.look(gateway, "V-2", ["V-1", "V-2"], wait)
    put.("V-1", 1, true)
    assert {:waiting, "V-1 is not known" <> _, "V-1"} = Wait.look(gateway, "V-2", ["V-1", "V-2"], wait)
    put.("V-1", 1, false)
    assert :ok = Wait.look(gateway, "V-2", ["V-1", "V-2"], wait)
  end

  test "Return all: each to its own height at once, waiting for itself only, and not for ever" do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})

    # So many metres from its home, and so high.
    fly = fn {id, metres, height, autopilot}, n ->
      position = %{lat: 47.0 + metres / 111_000, lon: 8.0, alt_rel: height}
      home = %{lat: 47.0, lon: 8.0}
      data = %{mode: %{in_air: true, armed: true}, position: position, home: home}

      Store.put_vehicle(gateway, {"main", n}, %Snapshot{
        id: id,
        key: {"main", n},
        network: "main",
        system_id: n,
        status: :online,
        autopilot: autopilot,
        vehicle_type: "copter",
        groups: Map.new(data, fn {group, data} -> {group, %{at: 0, data: data}} end)
      })
    end

    flying = [
      {"FAR", 100, 36.5, :ardupilot},
      {"NEAR", 10, 20.0, :px4},
      {"MSP", 50, 40.0, :betaflight},
      {"DEEP", 200, nil, :ardupilot},
      {"HIGH", 300, 300.0, :px4}
    ]

    flying |> Enum.with_index(1) |> Enum.each(fn {vehicle, n} -> fly.(vehicle, n) end)
    ids = for {id, _metres, _height, _firmware} <- flying, do: id
    assert %{"step" => 100, "halt_ratio" => 1} = request = Ending.request(gateway, ids, MapSet.new(), "rtl")
    {:ok, parsed} = Sequence.parse(request["sequence"], 5, 0)
    home = {:command, "rtl", %{}}
    assert Enum.all?(parsed, &(List.last(&1.steps) == home))

    waits =
      for %{vehicle: id, steps: [{:command, "set_altitude", %{"altitude" => to}}, {:wait, wait}, ^home]} <-
            parsed do
        assert %{for: :at, m: ^to, of: nil, go_on?: true} = wait
        {id, to, wait.timeout_ms}
      end

    assert waits == [{"NEAR", 30, 20_000}, {"FAR", 36, 10_500}, {"DEEP", 39, 49_000}, {"HIGH", 42, 90_000}]
    # Its firmware takes no height, so it asks for none.
    assert %{steps: [^home]} = Enum.find(parsed, &(&1.vehicle == "MSP"))

    # One alone meets nobody.
    assert %{"sequence" => [%{"steps" => [%{"type" => "rtl"}]}]} =
             Ending.request(gateway, ["FAR"], MapSet.new(), "rtl")
  end

  test "the height of the firmware's own is that of its parameters, as they were read the last time" do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
    assert Returning.own_m(gateway, "V-1") == nil

    for {name, value, metres} <- [
          {"RTL_ALT", 6_000, 60.0},
          {"RTL_ALT_M", 45, 45},
          {"RTL_RETURN_ALT", 60.0, 60.0},
          {"RTL_ALTITUDE", -1, 0},
          {"RTL_ALT_FINAL", 900, nil},
          {"WPNAV_SPEED", 500, nil}
        ] do
      id = "V-" <> name
      :ok = Journal.commit(gateway, id, %{}, [], %{name => value})
      assert Returning.own_m(gateway, id) == metres
    end
  end
end
