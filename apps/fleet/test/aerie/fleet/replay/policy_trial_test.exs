defmodule Aerie.Fleet.Replay.PolicyTrialTest do
  @moduledoc "Flights of real firmware with what pymavlink sent in them, against policies."
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet.Replay.{PolicyTrial, Settings}
  alias Aerie.Vehicle.Command
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @fixtures Path.expand("../../../../../vehicle/test/fixtures", __DIR__)
  @start 1_795_000_000_000_000
  @second 1_000_000

  defp flight(name) do
    sent = Aerie.Flight.parse(File.read!(Path.join(@fixtures, name <> "_tx.tlog")))
    Enum.sort_by(Aerie.Flight.frames(name) ++ sent, & &1.at)
  end

  defp trial(section, options \\ []) do
    {:ok, policy} = Policy.compile(section)

    as = fn
      {:station, ids} -> Roles.principal(:client, ids, :operator)
      {:source, name} -> Roles.principal(:key, name, :operator)
    end

    PolicyTrial.new(policy, Settings.from(%{}), Keyword.put_new(options, :as, as))
  end

  # All decisions of one recording, or of several.
  defp play(trial, frames, label \\ "flight") do
    {decisions, trial} =
      Enum.flat_map_reduce(frames, PolicyTrial.recording(trial, label), fn frame, trial ->
        {trial, decisions} = PolicyTrial.push(trial, frame)
        {decisions, trial}
      end)

    {decisions, trial}
  end

  defp rules(decisions), do: decisions |> Enum.map(&rule/1) |> Enum.frequencies()
  defp rule(%{decision: :allow}), do: :allow
  defp rule(%{decision: {:deny, rule, _reason}}), do: rule

  defp frame(message, second, options),
    do: Aerie.Flight.frame(message, @start + round(second * @second), options)

  defp beat(second, options \\ []),
    do: frame(%M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4}, second, options)

  defp arm(second, options \\ []) do
    message = %M.CommandLong{
      command: MavCmd.value(:MAV_CMD_COMPONENT_ARM_DISARM),
      param1: 1.0,
      target_system: 1
    }

    frame(message, second, Keyword.merge([system: 255, component: 190], options))
  end

  test "a flight of ArduCopter against a limit of height" do
    # Its mission goes higher, so that to enter it is refused as well.
    {decisions, trial} = play(trial(%{max_altitude: 15}), flight("arducopter_flight"))

    assert rules(decisions) == %{allow: 29, altitude: 10, role: 1, unknown: 1}

    assert Enum.find(decisions, &(&1.name == "NAV_TAKEOFF")) |> Map.drop([:at]) == %{
             who: "255/190",
             role: :operator,
             via: "mavlink",
             vehicle: "VID-001",
             name: "NAV_TAKEOFF",
             command: "takeoff",
             decision:
               {:deny, :altitude, "the height to climb to is 20 m above home; at most 15 m is allowed"},
             lacking: []
           }

    assert PolicyTrial.skipped(trial) == %{}
    assert PolicyTrial.summary(trial).vehicles == ["VID-001"]
  end

  test "the vehicle is as it was at the time of each command" do
    section = %{
      conditions: [%{types: ["set_mode"], in_air: true}],
      modes: %{transitions: %{"GUIDED" => ["AUTO"]}}
    }

    {decisions, _trial} = play(trial(section), flight("arducopter_flight"))

    assert [{:deny, :condition, on_the_ground}, :allow | more] =
             for(%{command: "set_mode", decision: decision} <- decisions, do: decision)

    assert on_the_ground =~ "it is on the ground"
    # The vehicle was in AUTO by then, from which there is no rule.
    assert Enum.all?(more, &(&1 == :allow))
  end

  test "a flight of PX4 against the rates of the policy, in the flight's time" do
    rates = [%{types: ["arm"], per_minute: 1, burst: 1}]
    {decisions, _trial} = play(trial(%{rates: rates}), flight("px4_refusals"))
    arming = for %{command: "arm"} = decision <- decisions, do: {div(decision.at, @second), rule(decision)}
    allowed = for {at, :allow} <- arming, do: at
    assert length(allowed) >= 2
    assert Enum.any?(arming, &match?({_at, :rate}, &1))
    for [one, next] <- Enum.chunk_every(allowed, 2, 1, :discard), do: assert(next - one >= 59)
  end

  test "the same recordings give the same decisions, and those of another one are copies" do
    frames = flight("px4_flight")
    {decisions, trial} = play(trial(%{max_altitude: 15}), frames)
    assert {^decisions, _trial} = play(trial(%{max_altitude: 15}), frames)
    assert length(decisions) > 100

    assert {[], trial} = play(trial, frames, "link")
    assert PolicyTrial.skipped(trial).copy >= length(decisions)
  end

  describe "what is not judged" do
    test "commands to a vehicle that was not heard, of vehicles, and what nobody's may reach a vehicle" do
      never = frame(%M.SetupSigning{target_system: 1}, 3, system: 255, component: 190)
      frames = [arm(0), beat(1), beat(1, system: 2), arm(2, system: 2, component: 1), never]
      {decisions, trial} = play(trial(%{}), frames)
      assert decisions == []
      assert PolicyTrial.skipped(trial) == %{unheard: 1, vehicle: 1, never: 1}
    end

    test "questions, heartbeats and a vehicle's words to its own parts" do
      question = %M.CommandLong{
        command: MavCmd.value(:MAV_CMD_REQUEST_MESSAGE),
        param1: 33.0,
        target_system: 1
      }

      station = [system: 255, component: 190]
      own = arm(4, system: 1, component: 191)

      frames = [
        beat(1),
        frame(question, 2, station),
        frame(%M.Heartbeat{type: 6, autopilot: 8}, 3, station),
        own
      ]

      assert {[], trial} = play(trial(%{}), frames)
      assert PolicyTrial.skipped(trial) == %{}
    end

    test "garbage of any kind" do
      junk = %MavCodec.Tlog.Damage{kind: :bytes, offset: 0, bytes: 7}
      strange = %{arm(2) | payload: <<>>, id: 16_000_000, crc_extra: nil}
      {decisions, trial} = play(trial(%{}), [junk, beat(1), strange, arm(3)])
      assert [%{command: "arm"}] = decisions
      assert PolicyTrial.skipped(trial) == %{unknown: 1}
      assert PolicyTrial.summary(trial).damaged_parts == 1
    end
  end

  test "a command for all vehicles is judged for each; one for one of them is not" do
    all = arm(2, seq: 7) |> then(fn _one -> %M.SetMode{target_system: 0, base_mode: 1, custom_mode: 4} end)
    frames = [beat(1), beat(1, system: 2), frame(all, 2, system: 255, component: 190), arm(3)]
    {decisions, _trial} = play(trial(%{}), frames)

    assert Enum.map(decisions, &{&1.vehicle, &1.command}) ==
             [{"VID-001", "set_mode"}, {"VID-002", "set_mode"}, {"VID-001", "arm"}]
  end

  test "a recording that goes on with the last one keeps what is known; another one, or a clock that goes back, does not" do
    rates = %{rates: [%{types: ["arm"], per_minute: 1, burst: 1}]}
    {[%{decision: :allow}], trial} = play(trial(rates), [beat(0), arm(1)], "main-VID-001")

    assert {[%{decision: {:deny, :rate, _reason}}], _trial} = play(trial, [arm(11, seq: 1)], "main-VID-001")
    assert {[], later} = play(trial, [arm(300, seq: 1)], "main-VID-001")
    assert PolicyTrial.skipped(later) == %{unheard: 1}
    assert {[], _other} = play(trial, [arm(11, seq: 1)], "main-VID-002")

    # An hour earlier: no token of the future counts.
    assert {[%{decision: :allow}, %{decision: {:deny, :rate, _reason}}], _trial} =
             play(
               trial,
               [arm(11 - 3600, seq: 2), arm(20 - 3600, seq: 3)] |> then(&[beat(10) | &1]),
               "main-VID-001"
             )
  end

  describe "the ledger" do
    defp entry(id, second, type, params, source) do
      {:ok, command} =
        Command.new([id: id, vehicle: "VID-001", type: type, params: params, source: source], @start)

      %{id: id, at: @start + second * @second, envelope: Command.plain(command)}
    end

    # What the gateway itself sends.
    defp own(message, second), do: frame(message, second, own_ids())

    defp own_ids do
      identity = Settings.from(%{}).vehicle.identity
      [system: identity.system_id, component: identity.component_id]
    end

    test "its commands have their sender, and stand for the gateway's frames" do
      named = fn
        "boss", _at -> Roles.principal(:key, "boss", :admin)
        _other, _at -> nil
      end

      ledger = [
        entry("before", -50, "reboot", %{}, "boss"),
        entry("a", 2, "reboot", %{}, "boss"),
        entry("b", 3, "reboot", %{}, "guest"),
        %{id: "c", at: @start + 4 * @second, envelope: %{"vehicle" => "VID-001", "type" => "dance"}},
        %{id: "e", at: @start + 4 * @second, envelope: %{"vehicle" => "VID-009", "type" => "rtl"}},
        %{id: "d", at: @start + 4 * @second, envelope: %{}}
      ]

      frames = [beat(1), arm(2, own_ids()), beat(5), beat(6)]
      {decisions, trial} = play(trial(%{}, ledger: ledger, named: named), frames)

      assert Enum.map(decisions, &{&1.who, &1.role, &1.command, &1.via, rule(&1)}) ==
               [{"boss", :admin, "reboot", "ledger", :allow}, {"guest", :operator, "reboot", "ledger", :role}]

      assert PolicyTrial.unnamed(trial) == ["guest"]
      assert PolicyTrial.missing(trial) == %{"VID-009" => 1}
      assert PolicyTrial.skipped(trial) == %{in_ledger: 1, malformed: 2}
      # In another recording of the same flight they were judged already.
      assert {[], _trial} = play(trial, frames, "link")
    end

    test "a transfer is judged by its frames, with the sender of the ledger" do
      set = %M.ParamSet{target_system: 1, param_id: "FENCE_ENABLE", param_value: 0.0}
      envelope = %{"vehicle" => "VID-001", "type" => "set_parameter", "source" => "boss", "params" => %{}}
      ledger = [%{id: "p", at: @start + 2 * @second, envelope: envelope}]
      frames = [beat(1), own(set, 3)]

      assert {[%{who: "gateway", decision: {:deny, :role, _reason}}], _trial} = play(trial(%{}), frames)

      named = fn "boss", _at -> Roles.principal(:key, "boss", :admin) end
      {decisions, _trial} = play(trial(%{}, ledger: ledger, named: named), frames)
      assert [%{who: "gateway (boss)", name: "PARAM_SET FENCE_ENABLE", decision: :allow}] = decisions
    end
  end
end
