defmodule Aerie.System.BeliefsTest do
  @moduledoc """
  Each cell of the table in docs/security.md of what the gateway believes, attempted against a whole gateway:
  "nothing" means that what it believes is the same afterwards, anything else that it is not.
  """

  use Aerie.SystemCase, async: true

  import Aerie.AuthorityCase

  alias Aerie.Program
  alias Aerie.Base.Names
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Vehicle.Session.Core
  alias MavCodec.Messages, as: M
  alias MavRouter.Router

  @moduletag :tmp_dir
  @moduletag capture_log: true

  @vehicle {"main", 1}
  @page Path.expand("../../docs/security.md", __DIR__)
  @external_resource @page
  @columns ["a stranger on the link", "a viewer", "another vehicle", "an operator"]

  defp rows do
    [_before, section] = @page |> File.read!() |> String.split("<!-- beliefs -->\n")
    [table, _after] = String.split(section, "<!-- /beliefs -->")
    [head, _line | rows] = table |> String.split("\n", trim: true) |> Enum.map(&cells/1)
    for row <- rows, do: head |> Enum.zip(row) |> Map.new()
  end

  defp cells(line), do: line |> String.trim("|") |> String.split("|") |> Enum.map(&String.trim/1)

  # What is said as the vehicle, or as a station; `n` tells the attempts apart.
  defp attempts("address", _n), do: as_vehicle([%M.Ping{seq: 1}, %M.Attitude{}, heartbeat() | restart()])

  defp attempts("firmware", _n),
    do: as_vehicle([heartbeat(autopilot: 12, type: 1), %M.AutopilotVersion{uid: 7}])

  defp attempts("armed", _n), do: as_vehicle([heartbeat(base_mode: 1)])

  defp attempts("in the air", _n),
    do: as_vehicle([%M.ExtendedSysState{landed_state: 1}, heartbeat(system_status: 1, base_mode: 1)])

  defp attempts("home", _n), do: as_vehicle([%M.HomePosition{latitude: 470_000_000, longitude: 80_000_000}])

  defp attempts("parameters", _n) do
    as_vehicle(
      for name <- ["SYSID_MYGCS", "MAV_GCS_SYSID", "FENCE_ENABLE"],
          do: %M.ParamValue{param_id: name, param_value: 9.0, param_type: 9, param_count: 1}
    )
  end

  defp attempts("station", n), do: [station(200 + n), station(255), encode(heartbeat(), 255, 1)]

  defp attempts("lease", n) do
    request = &command("REQUEST_OPERATOR_CONTROL", &1, param1: 1.0)
    [station(200 + n), request.(200 + n), request.(1)]
  end

  defp as_vehicle(messages),
    do: for(message <- messages, component <- [1, 0, 7], do: encode(message, 1, component))

  defp heartbeat(fields \\ []) do
    struct!(
      %M.Heartbeat{
        type: 2,
        autopilot: 3,
        base_mode: 0x51,
        custom_mode: 4,
        system_status: 3,
        mavlink_version: 3
      },
      fields
    )
  end

  # A clock that starts over.
  defp restart,
    do: for(ms <- [900_000, 10, 600, 1_200, 1_800], do: %M.SystemTime{time_boot_ms: ms, time_unix_usec: 1})

  defp encode(message, system, component), do: MavCodec.encode(message, system: system, component: component)

  # What the gateway believes now. The session has handled all that it was sent before.
  defp believed("address", c), do: Router.route(c.gateway, @vehicle)
  defp believed("firmware", c), do: Map.take(snapshot(c), [:autopilot, :vehicle_type, :type, :firmware, :uid])
  defp believed("armed", c), do: snapshot(c).groups.mode.data.armed
  defp believed("in the air", c), do: snapshot(c).groups.mode.data.in_air
  defp believed("home", c), do: snapshot(c).groups.home.data

  defp believed("parameters", c) do
    %{params: params, gcs: gcs} = snapshot(c)
    {params, gcs.failsafe_gcs}
  end

  defp believed("lease", c), do: Holders.of(c.gateway, @vehicle)

  defp believed("station", c) do
    for {{id, system, _command, _seq}, n} <- settle(c),
        id == M.Heartbeat.id(),
        system not in [77, 237],
        do: {system, n}
  end

  defp snapshot(c) do
    session = Names.whereis(c.gateway, :session, @vehicle)
    Core.snapshot(:sys.get_state(session, Aerie.Patience.ms()).core)
  end

  defp who("a stranger on the link", c), do: program(c, {:link, lan_address()})
  defp who("a viewer", c), do: program(c, {:tcp, "viewer-tcp"})
  defp who("an operator", c), do: program(c, {:tcp, "operator-tcp"})

  defp who("another vehicle", c) do
    program = program(c, {:link, lan_address()})
    Program.deliver(program, [encode(heartbeat(), 77, 1)])
    program
  end

  test "nobody changes what the gateway believes but by what proves it", %{tmp_dir: folder} do
    c = start_authority(folder, [:viewer], params: %{"SYSID_MYGCS" => 255.0, "FENCE_ENABLE" => 0.0})
    eventually(fn -> match?({_params, 255}, believed("parameters", c)) end, "a parameter is known")
    eventually(fn -> snapshot(c).groups[:home] end, "home is known")
    rows = rows()
    assert length(rows) == 8

    # The operator last: what he takes he keeps.
    for {column, i} <- Enum.with_index(@columns),
        program = who(column, c),
        {row, j} <- Enum.with_index(rows) do
      %{"what" => what} = row
      n = (2 * (8 * i + j)) |> rem(38)
      before = believed(what, c)
      Program.deliver(program, attempts(what, n))

      case row[column] do
        "nothing" <> _reason ->
          assert {column, what, before} == {column, what, believed(what, c)}

        _something ->
          eventually(fn -> believed(what, c) != before end, fn -> "#{column} changes #{what}" end)
      end
    end
  end
end
