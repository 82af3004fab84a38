defmodule Msp.PlacesTest do
  @moduledoc "iNav's home and where it is to fly: only where it takes them, and only what it says itself counts."
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias Msp.Test.{Line, Simulated}
  alias SimVehicle.Msp.Firmware

  @second 1_000_000
  @reposition 192
  @set_home 179
  @armed [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000, 1000]
  @held [1500, 1500, 1000, 1500, 1900, 1000, 1300, 1000, 1900]

  defp up(firmware \\ :inav) do
    {answer, change, state} = Simulated.controller(firmware)
    line = Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end)
    {Line.run(line, 7 * @second), change, state}
  end

  defp switch(line, change, channels) do
    change.(&Firmware.sticks(&1, channels))
    Line.run(line, @second)
  end

  defp command(line, message),
    do:
      line
      |> Line.handle(
        {:mavlink,
         MavCodec.encode(%{message | target_system: 42, target_component: 1}, system: 237, component: 191)}
      )
      |> Line.run(@second)

  defp goto(more \\ []),
    do:
      struct!(
        %M.CommandInt{command: @reposition, frame: 6, x: 474_000_000, y: 85_500_000, z: 30.0, param4: :nan},
        more
      )

  defp acks(line), do: for({_at, ack} <- Line.told(line, M.CommandAck), do: ack.result)
  defp notes(line), do: Enum.join(for({_at, text} <- Line.told(line, M.Statustext), do: text.text))

  test "taken where the pilot has switched it on, and read back" do
    {line, change, state} = up()
    line = line |> switch(change, @armed) |> switch(change, @held) |> command(goto())
    assert acks(line) == [0]
    assert state.().mission.desired == <<474_000_000::32-little, 85_500_000::32-little, 3000::32-little>>
    line = command(line, %M.CommandInt{command: @set_home, frame: 5, x: 473_900_000, y: 85_400_000, z: 500.0})
    assert acks(line) == [0, 0]
    assert {_at, %{latitude: 473_900_000, longitude: 85_400_000}} = List.last(Line.told(line, M.HomePosition))
    line = command(line, %M.CommandLong{command: @set_home, param1: 1.0})
    assert acks(line) == [0, 0, 0]
    assert <<473_977_420::32-little, _::binary>> = state.().mission.home
  end

  test "a height above sea level, or above a home that is higher than the origin, is given as one above the origin" do
    {line, change, state} = up()
    # The origin is at 488 m, and it was armed 20 m above that.
    change.(&%{&1 | flight: %{&1.flight | alt: 20.0}})
    line = switch(line, change, @armed)
    <<home::32-little-signed>> = binary_part(state.().mission.home, 8, 4)
    assert home > 1000
    line = line |> switch(change, @held) |> command(goto(frame: 5, z: 518.0))
    assert acks(line) == [0]
    assert_in_delta height(state), 3000, 50
    line = command(line, goto(frame: 6, z: 30.0))
    assert acks(line) == [0, 0]
    assert_in_delta height(state), home + 3000, 50
    # The height of home stays, although 0 would be the origin's.
    line = command(line, %M.CommandInt{command: @set_home, frame: 5, x: 473_900_000, y: 85_400_000})
    assert acks(line) == [0, 0, 0]
    assert <<kept::32-little-signed>> = binary_part(state.().mission.home, 8, 4)
    assert_in_delta kept, home, 50
  end

  test "heights are those above home, wherever its origin is" do
    {line, change, _state} = up()

    last = fn line ->
      line |> Line.told(M.Altitude) |> List.last() |> elem(1) |> Map.fetch!(:altitude_relative)
    end

    line = switch(line, change, @armed)
    assert_in_delta last.(line), 0.0, 0.1
    # It hovers at 25 m; its pilot sets another home, 20 m above the origin.
    line = switch(line, change, [1500, 1500, 1500 | Enum.drop(@armed, 3)])
    change.(&%{&1 | flight: %{&1.flight | alt: 25.0}})
    line = Line.run(line, @second)
    assert_in_delta last.(line), 25.0, 0.1
    home = <<473_977_420::32-little, 85_455_940::32-little, 2000::32-little>>
    change.(&%{&1 | mission: %{&1.mission | home: home}})
    line = Line.run(line, 6 * @second)
    assert_in_delta last.(line), 5.0, 0.1
    assert {_at, %{altitude: 508_000}} = List.last(Line.told(line, M.HomePosition))
  end

  test "without a home there are heights above sea level only" do
    {line, change, state} = up()
    line = line |> switch(change, @armed) |> switch(change, @held)
    change.(&%{&1 | mission: %{&1.mission | home: nil}})
    line = command(line, goto())
    assert acks(line) == [2]
    assert notes(line) =~ "it does not say how high its home is"
    line = command(line, goto(frame: 5, z: 518.0))
    assert acks(line) == [2, 0]
    assert_in_delta height(state), 3000, 50
  end

  test "another height than the one that was set is not acknowledged" do
    {answer, change, _state} = Simulated.controller(:inav)

    higher = fn bytes, us ->
      case answer.(bytes, us) do
        "" ->
          nil

        <<"$M>", 21, 118, 254, action, place::binary-size(8), cm::32-little, rest::binary-size(7), _sum>> ->
          payload = <<254, action, place::binary, cm + 48_800::32-little, rest::binary>>
          MavCodec.Msp.Frame.encode(%MavCodec.Msp.Frame{id: 118, direction: :reply, payload: payload})

        reply ->
          reply
      end
    end

    line = higher |> Line.open() |> Line.run(7 * @second)
    line = line |> switch(change, @armed) |> switch(change, @held) |> command(goto())
    assert acks(line) == [4]
    assert notes(line) =~ "has the height 1006.0 m above sea level instead of 518.0 m"
  end

  defp height(state) do
    <<_place::binary-size(8), cm::32-little-signed>> = state.().mission.desired
    cm
  end

  test "refused with the reason where iNav would acknowledge and ignore it" do
    {line, change, state} = up()
    line = command(line, goto())
    assert notes(line) =~ "it is not armed"
    line = line |> switch(change, @armed) |> command(goto())
    assert notes(line) =~ "GCS NAV"
    line = line |> switch(change, List.replace_at(@held, 6, 1000)) |> command(goto())
    assert notes(line) =~ "NAV POSHOLD"
    line = switch(line, change, @held)

    for wrong <- [goto(frame: 10), goto(x: 0, y: 0), goto(z: :nan)],
        do: assert(List.last(acks(command(line, wrong))) == 2)

    assert Enum.uniq(acks(line)) == [2]
    assert state.().mission.desired == nil
  end

  test "acknowledged, and not so: said as what it is" do
    {answer, change, _state} = Simulated.controller(:inav)
    # Waypoint 254 is another one.
    spoilt = fn bytes, us ->
      case answer.(bytes, us) do
        "" ->
          nil

        <<"$M>", 21, 118, 254, _::binary>> ->
          MavCodec.Msp.Frame.encode(%MavCodec.Msp.Frame{
            id: 118,
            direction: :reply,
            payload: <<254, 1, 0::152>>
          })

        reply ->
          reply
      end
    end

    line = spoilt |> Line.open() |> Line.run(7 * @second)
    line = line |> switch(change, @armed) |> switch(change, @held) |> command(goto())
    assert acks(line) == [4]
    assert notes(line) =~ "has another one"
  end

  test "Betaflight has neither" do
    {line, _change, _state} = up(:betaflight)
    assert acks(command(line, goto())) == [3]
    assert acks(command(line, %M.CommandInt{command: 16})) == [3]
  end
end
