defmodule Aerie.System.MspFirmwareTest do
  @moduledoc """
  Betaflight and iNav themselves, as their simulators on the PATH (`betaflight_SITL`, `inav_SITL`): parameters, missions, channels over MSP and the failsafe
  when they stop, and the line's recording, which has to give the same bytes again.
  """
  use Aerie.SystemCase, async: false

  import Aerie.PeerCase, only: [start_program: 2]

  alias Aerie.Control.{Commands, Missions, Params}
  alias Aerie.HubServer
  alias MavCodec.Msp.{Frame, Parser}

  @moduletag :tmp_dir
  @moduletag :capture_log
  @vehicle "VID-007"
  @key {"main", 7}
  @crew %{name: "crew", role: :admin, permissions: [:receiver]}
  # As long as the reports of a simulated body: at rest, level.
  @body for number <- [0, 0, 0, 0, 0, -9.80665, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 101_325],
            into: <<>>,
            do: <<number::float-little>>

  @mission """
  <mission>
    <missionitem action="WAYPOINT" lat="47.3977418" lon="8.5455939" alt="35"/>
    <missionitem action="POSHOLD_TIME" lat="47.3980418" lon="8.5459939" alt="40" parameter1="20"/>
    <missionitem action="RTH" flag="165"/>
  </mission>
  """

  # Restarts where the firmware ends instead. Each keeps its settings in the folder it runs in.
  defp start_firmware(name, dir) do
    home = Path.join(dir, "firmware")
    File.mkdir_p!(home)
    peer = start_program("sh", ["-c", "cd \"$1\"; while :; do $0 > log 2>&1; sleep 0.2; done", name, home])
    {:os_pid, pid} = Port.info(peer, :os_pid)
    on_exit(fn -> System.cmd("pkill", ["-9", "-P", "#{pid}"]) end)
  end

  defp gateway(dir, port) do
    share = HubServer.free_port()

    overrides = %{
      "timeouts" => patient(),
      "recorder" => %{"dir" => Path.join(dir, "recordings"), "links" => "always", "min_free_mb" => 0},
      "links" => [%{"id" => "fc", "url" => "msp:tcp:127.0.0.1:#{port}?sysid=7&share=#{share}"}],
      "policy" => %{
        "clients" => [%{"id" => "fc-share", "role" => "admin"}]
      }
    }

    %{gateway: gateway} = start_gateway(dir, links: [], overrides: overrides)
    :ok = Aerie.Base.PubSub.subscribe(gateway, :events)
    known(gateway)
    {gateway, share}
  end

  defp known(gateway), do: eventually(fn -> data(gateway, :health, @key)[:arming_checks] end, "it is known")

  defp submit(gateway, type, params \\ %{}) do
    command = [
      vehicle: @vehicle,
      type: type,
      params: params,
      as: @crew,
      deadline: System.os_time(:second) + 60
    ]

    {:ok, result} = Commands.submit(gateway, command)
    result
  end

  defp set(gateway, name, value) do
    {:ok, result} = Params.set(gateway, @vehicle, name, value, as: @crew)
    result.status
  end

  defp event(type) do
    receive do
      {:fleet, :events, %{type: ^type} = event} -> event
      {:fleet, :events, _other} -> event(type)
    after
      Aerie.Patience.ms() -> flunk("no event #{type}")
    end
  end

  # A program's request, which its policy lets through.
  defp ask(socket, id, payload) do
    :ok = :gen_tcp.send(socket, Frame.encode(%Frame{id: id, payload: payload}))
    reply(socket, id, Parser.new())
  end

  defp reply(socket, id, parser) do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, Aerie.Patience.ms())
    {frames, parser} = Parser.push(parser, bytes)

    case Enum.find(frames, &(&1.id == id)) do
      nil ->
        reply(socket, id, parser)

      frame ->
        assert frame.direction == :reply
        frame.payload
    end
  end

  defp done_again(gateway, dir) do
    :ok = MavRouter.Recorder.stop(gateway, {:link, "fc"})
    [file] = dir |> Path.join("recordings/main-fc-*.tlog") |> Path.wildcard()

    {_listed, notes} =
      Aerie.StandardError.capture(fn ->
        ExUnit.CaptureIO.capture_io(fn -> assert {0, ""} = Aerie.CLI.call(["msp", file], dir) end)
      end)

    notes
  end

  defp level_body do
    {:ok, socket} = :gen_udp.open(0)
    began = System.monotonic_time(:microsecond)
    report(socket, began)
  end

  defp report(socket, began) do
    seconds = (System.monotonic_time(:microsecond) - began) / 1.0e6
    _ = :gen_udp.send(socket, {127, 0, 0, 1}, 9003, <<seconds::float-little, @body::binary>>)
    Process.sleep(4)
    report(socket, began)
  end

  @tag :betaflight
  test "Betaflight: settings, armed by channels over MSP, and its failsafe when nobody steers", %{
    tmp_dir: dir
  } do
    start_firmware("betaflight_SITL", dir)
    start_supervised!({Task, &level_body/0})
    {gateway, share} = gateway(dir, 5761)
    {:ok, table} = Params.list(gateway, @vehicle)
    assert Params.Table.count(table) > 180
    assert set(gateway, "p_roll", 47) == :completed
    assert set(gateway, "vbat_warning_cell_voltage", 360) == :completed
    assert set(gateway, "vbat_warning_cell_voltage", 900) == :rejected
    assert {:ok, %{value: 47}} = Params.get(gateway, @vehicle, "p_roll")

    # Its receiver is MSP, and two switches arm it and choose a mode.
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, share, [:binary, active: false])
    <<features::32-little>> = ask(socket, 36, "")
    msp = features |> Bitwise.band(Bitwise.bnot(8)) |> Bitwise.bor(Bitwise.bsl(1, 14))
    ask(socket, 37, <<msp::32-little>>)
    ask(socket, 35, <<0, 0, 0, 32, 48>>)
    ask(socket, 35, <<1, 1, 1, 32, 48>>)
    ask(socket, 62, <<5, 0, 180>>)
    assert submit(gateway, "save_params").status == :accepted
    assert submit(gateway, "reboot").status == :completed
    event("reboot")

    eventually(fn -> submit(gateway, "arm").status == :completed end, "it is armed over MSP")
    assert submit(gateway, "set_mode", %{mode: "ANGLE"}).status == :completed
    assert %{armed: true, mode: "ANGLE"} = data(gateway, :mode, @key)
    assert set(gateway, "p_roll", 48) == :rejected
    assert submit(gateway, "manual_control", %{throttle: 0.3, hold: 1}).status == :accepted
    assert %{data: %{"reason" => "rc"}} = event("failsafe")
    eventually(fn -> data(gateway, :mode, @key).armed == false end, "its failsafe disarms it")
    assert done_again(gateway, dir) =~ "done again: the same"
  end

  @tag :inav
  test "iNav: settings by name, and a mission that is read back", %{tmp_dir: dir} do
    start_firmware("inav_SITL", dir)
    {gateway, _share} = gateway(dir, 5760)
    {:ok, table} = Params.list(gateway, @vehicle)
    assert Params.Table.count(table) > 600
    assert set(gateway, "nav_rth_linear_descent_start_distance", 250) == :completed
    assert set(gateway, "nav_rth_linear_descent_start_distance", 70_000) == :rejected

    {:ok, plan} = Missions.import(@mission, :any)
    assert {:ok, %{status: :completed}} = Missions.upload(gateway, @vehicle, :mission, plan, as: @crew)
    {:ok, back} = Missions.download(gateway, @vehicle, :mission)
    assert length(back.items) == 3
    assert submit(gateway, "save_params", %{what: "mission"}).status == :accepted
    assert done_again(gateway, dir) =~ "done again: the same"
  end
end
