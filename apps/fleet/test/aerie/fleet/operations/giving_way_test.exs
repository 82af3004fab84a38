defmodule Aerie.Fleet.Operations.GivingWayTest do
  @moduledoc "Which commands of others have an operation leave a vehicle alone."
  use ExUnit.Case, async: true

  alias Aerie.Base.Store
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Fleet.Operations.Sequence.GivingWay

  @way %{since_us: 100, ours: ["home", "up"], ends?: false}
  @at 1_800_000_163_000_000

  defp moved(type, us, id \\ "by-hand", ends? \\ false),
    do: %{at: @at, source: "ann", type: type, id: id, us: us, ends?: ends?}

  defp reason(moved, way \\ @way, setpoints \\ nil), do: GivingWay.reason(way, "V-1", moved, setpoints)

  test "the first command of somebody else since it began, by hand or of another operation" do
    assert reason([]) == nil
    assert reason([moved("hold", 99)]) == nil

    assert reason([moved("rtl", 130), moved("hold", 100)]) ==
             "it was given hold by ann at 08:02:43 UTC; this operation left it alone"

    for id <- [nil, "by-hand", GivingWay.command_id("other", "V-1"), GivingWay.command_id("home", "V-2", 0)],
        do: assert(reason([moved("goto", 101, id)]) =~ "it was given goto by ann")
  end

  test "not its own commands, nor those of the one that it aborts" do
    own = for id <- @way.ours, n <- [nil, 0, 15, 24], do: GivingWay.command_id(id, "V-1", n)
    assert own |> Enum.map(&moved("rtl", 101, &1)) |> reason() == nil
    # One of them after another one's does not hide that.
    assert reason([moved("hold", 101), moved("rtl", 102, hd(own))]) =~ "hold by ann"
  end

  test "set-points that already came do not count, and what begins later does" do
    setpoint = [moved("setpoint_velocity", 150)]
    assert reason(setpoint, @way, 50) == nil
    assert reason(setpoint, @way, 120) =~ "setpoint_velocity"
    assert reason(setpoint, @way, nil) =~ "setpoint_velocity"
    assert reason([moved("goto", 150)], @way, 50) =~ "goto"
  end

  test "what ends flights gives way only to what ends them as well" do
    ending = %{@way | ends?: true}
    assert reason([moved("goto", 101), moved("setpoint_velocity", 102)], ending) == nil
    assert reason([moved("land", 101, "x", true)], ending) =~ "land by ann"
    assert for(type <- ~w(hold rtl land disarm), do: GivingWay.ends?({:command, type, %{}})) |> Enum.all?()
    refute GivingWay.ends?({:command, "takeoff", %{}})
    refute GivingWay.ends?({:sequence, []})
  end

  test "arming, modes and moves are kept of a vehicle, and neither requests nor idle sticks of a ground station" do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
    way = GivingWay.new(["home"], false)

    note = fn type, id -> RecentCommands.note(gateway, "V-1", "ann", Intent.named(type), id) end
    for type <- ~w(set_message_interval take_control request_message), do: note.(type, "x")
    for type <- ~w(rc_override manual_control), do: note.(type, nil)
    assert GivingWay.reason(gateway, "V-1", way) == nil

    for type <-
          ~w(arm disarm force_disarm set_mode takeoff land rtl hold goto set_altitude mission_start mission_pause),
        way = GivingWay.new(["home"], false),
        :ok = note.(type, nil),
        do: assert(GivingWay.reason(gateway, "V-1", way) =~ "it was given #{type} by ann")

    way = GivingWay.new(["home"], false)
    note.("manual_control", "x")
    assert GivingWay.reason(gateway, "V-1", way) =~ "manual_control"
    assert GivingWay.reason(gateway, "V-2", way) == nil
    # A stream pushes nothing out.
    ending = %{GivingWay.new(["home"], true) | since_us: way.since_us}
    note.("hold", "y")
    for _n <- 1..50, do: note.("setpoint_velocity", nil)
    for _n <- 1..50, do: note.("goto", nil)
    assert GivingWay.reason(gateway, "V-1", ending) =~ "hold"
    assert length(RecentCommands.moved(gateway, "V-1")) <= 9
  end
end
