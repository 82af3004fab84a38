defmodule Aerie.Fleet.Operations.LandingTest do
  @moduledoc "Landing at a place: the steps, and the wait for the place, also as properties."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Operations.Sequence
  alias Aerie.Fleet.Operations.Sequence.{Landing, Wait}
  alias Aerie.Vehicle.Snapshot

  @there %{"lat" => 47.0, "lon" => 8.0, "altitude" => 20}

  # So many metres north of the place.
  defp seen(metres, more \\ []) do
    data = %{
      mode: %{in_air: Keyword.get(more, :in_air, true), mode: more[:mode] || "GUIDED", armed: true},
      position: %{lat: metres && 47.0 + metres / 111_195, lon: 8.0, alt_rel: 30},
      velocity: %{groundspeed: Keyword.get(more, :speed, 0.2)}
    }

    %Snapshot{
      id: "V-1",
      status: more[:status] || :online,
      autopilot: :ardupilot,
      vehicle_type: more[:kind] || "copter",
      groups: Map.new(data, fn {group, data} -> {group, %{at: 0, data: data}} end)
    }
  end

  test "it flies there, waits until it has arrived, and lands" do
    assert {:ok, %{"vehicle" => "V-1"} = vehicle} = Landing.steps(seen(200), @there)
    {:ok, [%{steps: steps}]} = Sequence.parse([vehicle], 1, 0)
    assert [{:command, "goto", @there}, {:wait, wait}, {:command, "land", %{}}] = steps
    assert for(step <- steps, do: Sequence.word(step)) == ~w(goto wait_near land)
    # 200 m at 2 m/s, 10 m down, and a minute.
    assert %{for: :near, m: 3, place: {47.0, 8.0}, timeout_ms: 170_000, go_on?: false} = wait
    assert Sequence.futile([%{vehicle: "V-1", steps: steps, else: []}]) == []

    timeout = fn metres, goto ->
      metres |> seen() |> Landing.steps(goto) |> elem(1) |> get_in(["steps"]) |> Enum.at(1)
    end

    assert timeout.(200, Map.put(@there, "speed", 0.5))["timeout_s"] == 470
    assert timeout.(30_000, @there)["timeout_s"] == 3_600
  end

  test "what cannot land there, or whose state is not known, is refused with the reason" do
    for {seen, why} <- [
          {seen(200, kind: "plane"), "has wings"},
          {seen(200, kind: "vtol"), "has wings"},
          {seen(200, status: :lost), "lost"},
          {seen(200, in_air: false), "on the ground"},
          {seen(200, in_air: nil), "not known to be in the air"},
          {seen(nil), "position is not known"}
        ] do
      assert {:error, text} = Landing.steps(seen, @there)
      assert text =~ why
    end
  end

  defp near(seen, mode \\ "GUIDED"),
    do: Wait.look(%{for: :near, m: 3, place: {47.0, 8.0}, of: nil, mode: mode}, seen, [])

  test "it has arrived when it is near and slow; who changes its mode ends that" do
    assert near(seen(2)) == :ok
    assert {:waiting, "40 m from the place, not within 3 m", "V-1"} = near(seen(40))
    assert {:waiting, "it is not known to be slower" <> _, "V-1"} = near(seen(2, speed: 3))
    assert {:waiting, "it is not known to be slower" <> _, "V-1"} = near(seen(2, speed: nil))
    assert {:waiting, "its position is not known", "V-1"} = near(seen(nil))

    # A pilot, a failsafe; PX4 flies there in its holding mode, and the mode may be seen late.
    for {from, to} <- [
          {"GUIDED", "LOITER"},
          {"GUIDED", "STABILIZE"},
          {"GUIDED", "RTL"},
          {"AUTO_LOITER", "POSCTL"}
        ],
        do: assert({:failed, "its mode was changed to " <> ^to <> _} = near(seen(2, mode: to), from))

    for {from, to} <- [
          {"AUTO_LOITER", "AUTO_LOITER"},
          {"AUTO_MISSION", "AUTO_LOITER"},
          {"LOITER", "LOITER"},
          {"AUTO", "GUIDED"}
        ],
        do: assert(near(seen(2, mode: to), from) == :ok)
  end

  test "it never lands unless it is near, slow, and in the mode in which it was sent" do
    maybe = &:proper_types.oneof([nil, &1])
    metres = maybe.(:proper_types.integer(0, 10))
    speed = maybe.(:proper_types.integer(0, 4))
    mode = :proper_types.oneof(~w(GUIDED LOITER AUTO_LOITER RTL LAND STABILIZE AUTO))

    property =
      :proper.forall(:proper_types.list({metres, speed, mode}), fn seconds ->
        # As the task looks: until the wait has its end.
        {answer, last} =
          Enum.reduce_while(seconds, {nil, nil}, fn {metres, speed, mode} = second, _before ->
            case near(seen(metres, speed: speed, mode: mode)) do
              {:waiting, _why, "V-1"} -> {:cont, {nil, second}}
              answer -> {:halt, {answer, second}}
            end
          end)

        case {answer, last} do
          {:ok, {metres, 0, "GUIDED"}} ->
            metres in 0..3

          {{:failed, _why}, {_metres, _speed, mode}} ->
            mode != "GUIDED"

          {nil, _none_or_last} ->
            Enum.all?(seconds, fn {metres, speed, mode} ->
              mode == "GUIDED" and not (metres in 0..3 and speed == 0)
            end)

          _landed_else ->
            false
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end
end
