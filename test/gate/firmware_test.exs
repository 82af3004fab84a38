defmodule Aerie.Gate.FirmwareTest do
  @moduledoc """
  A firmware is its folder and one line: in a machine of its own, the list of firmwares has a fifth one, and every part
  knows it.
  """

  use ExUnit.Case, async: true

  alias Aerie.Control.Policy.{Intent, Mavlink}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Rules.Role
  alias Aerie.Vehicle.{Command, Firmware, Protocol, State}
  alias Aerie.Vehicle.Firmware.Modes
  alias MavCodec.Messages, as: M

  @list Path.expand("../../apps/vehicle/lib/aerie/vehicle/firmware.ex", __DIR__)
  @last "inav: __MODULE__.Inav.Adapter"
  @number 14

  setup_all do
    {:ok, peer, _node} = :peer.start_link(%{connection: :standard_io, wait_boot: :infinity})
    there = fn module, function, arguments -> :peer.call(peer, module, function, arguments, :infinity) end
    :ok = there.(:code, :add_pathsa, [:code.get_path()])
    {:ok, _apps} = there.(:application, :ensure_all_started, [:elixir])
    :ok = there.(Code, :put_compiler_option, [:ignore_module_conflict, true])
    [before, rest] = @list |> File.read!() |> String.split(@last)
    list = before <> @last <> ",\n      fifth: Aerie.FifthFirmware.Adapter" <> rest
    [{Firmware, _code}] = there.(Code, :compile_string, [list])
    %{there: there}
  end

  defp beat(state, there) do
    beat = %M.Heartbeat{autopilot: @number, type: 2, base_mode: 0x81, custom_mode: 5, system_status: 4}
    there.(State, :apply, [state, M.Heartbeat.id(), beat, 1]) |> elem(0)
  end

  test "it is heard, and its state is read in its way", %{there: there} do
    assert there.(Firmware, :names, []) == [:ardupilot, :px4, :betaflight, :inav, :fifth]
    assert there.(Firmware, :title, [:fifth]) == "Fifth"
    # Without the line it is one of those that are not known.
    assert beat(%State{}, &apply/3).autopilot == :generic

    state = beat(%State{}, there)
    assert state.autopilot == :fifth
    assert State.data(state, :mode).mode == "FIVE"
    {state, _groups} = there.(State, :apply, [state, M.RcChannels.id(), %M.RcChannels{rssi: 5}, 2])
    assert State.data(state, :rc).rssi == 0.5
  end

  test "it gets commands, and lacks what it says", %{there: there} do
    vehicle = %Protocol.Vehicle{system: 1, autopilot: :fifth, kind: "copter"}
    adapter = there.(Firmware, :of, [:fifth])
    plan = fn type -> there.(Protocol, :plan, [adapter, command(type), vehicle]) end
    assert {:ok, [step]} = plan.("arm")
    assert [%M.CommandLong{command: 400, param1: 1.0}] = there.(adapter, :encode, [step, 0, vehicle])
    assert plan.("land") == {:gap, "Fifth only arms"}
    assert {:ok, 5, "FIVE"} = there.(Modes, :find, [vehicle, "five"])
  end

  test "the policy judges what it is sent as it reads it", %{there: there} do
    vehicle = %{autopilot: :fifth, vehicle_type: "copter"}
    mode = %M.SetMode{base_mode: 1, custom_mode: 5}
    assert %{mode: "FIVE", modes: []} = there.(Mavlink, :facts, [mode, vehicle])
    go = %M.CommandLong{command: 192, param5: 47.0, param6: 8.0, param7: 500.0}
    assert %{path: {:to, [%{height: {:msl, 500.0}}]}} = there.(Mavlink, :facts, [go, vehicle])
    assert {:ok, context} = there.(Context, :parse, [%{"autopilot" => "fifth"}, nil, 0])
    assert context.autopilot == :fifth

    # An operator arms it by a command; a vehicle whose firmware is not known may be steered by channels.
    operator = %{name: "olga", role: :operator, permissions: []}

    lacking =
      &there.(Role, :lacking, [unlimited(), Intent.named("arm"), %{context | source: operator, autopilot: &1}])

    assert lacking.(:fifth) == nil
    assert {:receiver, _why} = lacking.(:generic)
  end

  test "pages and lists have it", %{there: there} do
    assert there.(Modes, :meanings, ["FIVE"]) == [{:fifth, "any", 5}]
    assert there.(Firmware.Page, :sections, [])["gaps"] =~ "| `land` | Fifth | all | Fifth only arms |"
    assert there.(Firmware, :by_text, [])["fifth"] == :fifth
  end

  defp command(type) do
    {:ok, command} = Command.new(vehicle: "v", type: type, params: %{})
    command
  end

  defp unlimited, do: %{fence: nil, max_altitude: nil, min_altitude: nil, max_altitude_msl: nil, pilot: nil}
end
