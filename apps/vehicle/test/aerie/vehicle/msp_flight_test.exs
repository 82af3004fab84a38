defmodule Aerie.Vehicle.MspFlightTest do
  @moduledoc "Flights of simulated flight controllers over MSP, from their bytes to events, in simulated time."
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [run: 2, step: 2]

  alias Aerie.Vehicle.State
  alias Msp.Session
  alias SimVehicle.Msp.Firmware

  @low [1500, 1500, 1000, 1500, 1000, 1900, 1000, 1000]
  @armed List.replace_at(@low, 4, 1900)
  @climb List.replace_at(@armed, 2, 1900)

  # The frames that come while the pilot holds sticks for some seconds, one after the other.
  defp fly(firmware, options, flown) do
    start = %{
      fc: firmware |> Firmware.new(options) |> Firmware.connect(:port),
      session: Session.new(42),
      now: 0,
      wake: 0,
      said: [],
      frames: []
    }

    flight =
      Enum.reduce([{@low, 9} | flown], event(start, :opened), fn {sticks, seconds}, flight ->
        Enum.reduce(1..(seconds * 100), flight, fn _turn, flight -> turn(flight, sticks) end)
      end)

    linked = [] |> run(system_id: 42) |> step({:link, "link", %{high_latency: false, msp: true}})
    flown = flight.frames |> Enum.reverse() |> Enum.reduce(linked, &step(&2, {:frames, "link", [&1]}))
    %{flown | events: Enum.reverse(flown.events)}
  end

  defp turn(flight, sticks) do
    {fc, said} = flight.fc |> Firmware.sticks(sticks) |> Firmware.step(10_000)
    coming = flight.said ++ said
    flight = %{flight | fc: fc, now: flight.now + 10_000, said: []}
    flight = Enum.reduce(coming, flight, fn {:port, bytes}, flight -> event(flight, {:bytes, bytes}) end)
    if flight.wake <= flight.now, do: event(flight, :tick), else: flight
  end

  defp event(flight, event) do
    {session, actions} = Session.handle(flight.session, event, flight.now)
    Enum.reduce(actions, %{flight | session: session}, &act/2)
  end

  defp act({:wake, at}, flight), do: %{flight | wake: at}

  defp act({:write, bytes}, flight) do
    {fc, said} = Firmware.receive(flight.fc, :port, bytes)
    %{flight | fc: fc, said: flight.said ++ said}
  end

  defp act({:frames, frames}, flight) do
    frames = for frame <- frames, do: %{frame | at: flight.now}
    %{flight | frames: Enum.reverse(frames) ++ flight.frames}
  end

  defp act(_other, flight), do: flight

  defp types(run), do: for(%{type: type} <- run.events, type in ~w(armed takeoff landed disarmed), do: type)
  defp data(run, group), do: State.data(run.core.state, group)

  @versions [betaflight: [], betaflight: [api: {1, 48}], inav: []]

  test "armed on the ground, 488 m above the sea, is not a take-off; up, down and disarmed is one flight" do
    for {firmware, options} <- @versions do
      ground = fly(firmware, options, [{@armed, 4}])
      assert types(ground) == ["armed"]
      assert %{in_air: false} = data(ground, :mode)
      assert_in_delta data(ground, :position).alt_rel, 0, 0.1
      assert_in_delta data(ground, :position).alt_msl, 488, 1

      flown = fly(firmware, options, [{@armed, 2}, {@climb, 3}, {@armed, 4}, {@low, 3}])
      assert types(flown) == ["armed", "takeoff", "landed", "disarmed"]
    end
  end

  test "disarmed, Betaflight does not say how high it is above home: nothing else is taken for that" do
    assert %{alt_rel: nil, lat: lat} = data(fly(:betaflight, [], []), :position)
    assert_in_delta lat, 47.4, 0.1
    assert %{alt_rel: nil} = data(fly(:betaflight, [], [{@armed, 3}, {@low, 3}]), :position)
  end

  test "a fall is not a landing" do
    for {firmware, options} <- @versions do
      dropped = fly(firmware, options, [{@armed, 2}, {@climb, 8}, {@low, 9}])
      assert types(dropped) == ["armed", "takeoff", "disarmed"]
    end
  end

  test "without an altimeter it is not known whether it is in the air" do
    for {firmware, options} <- @versions, blind = [blind: true] ++ options do
      run = fly(firmware, blind, [{@armed, 2}, {@climb, 4}])
      assert %{armed: true, in_air: nil} = data(run, :mode)
      assert types(run) == ["armed"]
      run = fly(firmware, blind, [{@armed, 2}, {@climb, 4}, {@low, 2}])
      assert %{armed: false, in_air: false} = data(run, :mode)
      assert types(run) == ["armed", "disarmed"]
    end
  end
end
