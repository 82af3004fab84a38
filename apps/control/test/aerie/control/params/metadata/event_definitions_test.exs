defmodule Aerie.Control.Params.Metadata.EventDefinitionsTest do
  @moduledoc "A vehicle's own descriptions of its events, from its first EVENT to what the fleet sees (X14)."
  use Aerie.TransferCase, async: true

  import Aerie.Flight, only: [frame: 3]
  import ExUnit.CaptureLog

  alias Aerie.Base.Names
  alias Aerie.Vehicle
  alias Aerie.Control.Params.Metadata.EventDefinitions
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @key {"main", 1}
  @general "etc/extras/component_general.json.xz"
  @events "/etc/extras/all_events.json"
  @newer 0x01000001

  @file_text JSON.encode!(%{
               version: 2,
               components: %{
                 "1": %{
                   namespace: "px4",
                   event_groups: %{
                     default: %{
                       events: %{
                         "1": %{
                           name: "newer_than_aerie",
                           message: "!",
                           arguments: [%{type: "uint8_t", name: "n"}]
                         }
                       }
                     }
                   }
                 }
               }
             })

  defp general(dir, types) do
    path = Path.join(dir, "general")
    File.write!(path, JSON.encode!(%{version: 1, metadataTypes: types}))
    {packed, 0} = System.cmd("xz", ["--stdout", "--check=crc32", path])
    packed
  end

  # The vehicle's first event says that it does not know this argument.
  defp start(dir, types, events) do
    {gateway, port} = start(dir)
    options = Vehicle.Options.new(Vehicle.Settings.of(gateway), @key)
    start_supervised!({EventDefinitions, gateway: gateway, options: options})
    fly(gateway, port, firmware: :px4, files: %{@general => general(dir, types), @events => events})
    arm = %M.CommandLong{target_system: 1, target_component: 1, command: 400, param1: 7.0}
    send(Names.whereis(gateway, :session, @key), {:transmit, [arm]})
    gateway
  end

  defp event(gateway, sequence) do
    boot_ms = Store.vehicle(gateway, @key).time_boot_ms

    message = %M.Event{
      id: @newer,
      sequence: sequence,
      event_time_boot_ms: boot_ms,
      log_levels: 0x66,
      arguments: <<7>>
    }

    frame = frame(message, System.os_time(:microsecond), component: 42, seq: sequence)
    Aerie.Reader.deliver(gateway, %{id: "radio", network: "main", peer: :one}, [frame])
  end

  defp reports(gateway),
    do: :sys.get_state(Names.via(gateway, :session, @key), Aerie.Patience.ms()).core.reports

  defp shown(gateway, sequence) do
    eventually(fn ->
      Enum.find(
        Store.vehicle(gateway, @key).reports.recent,
        &(&1.sequence == sequence and &1.id == "0x01000001")
      )
    end)
  end

  test "are read once, and win", %{tmp_dir: dir} do
    crc = :erlang.crc32(@file_text)

    gateway =
      start(
        dir,
        [%{type: 1, uri: "mftp://x"}, %{type: 4, uri: "mftp://" <> @events, fileCrc: crc}],
        @file_text
      )

    eventually(fn -> map_size(reports(gateway).own.events) == 1 end)
    event(gateway, 101)
    assert %{name: "newer_than_aerie", values: [7]} = shown(gateway, 101)
    assert [_kept] = Path.wildcard(Path.join(dir, "params/*.metadata"))
  end

  test "that cannot be read are reported once, and Aerie's own file applies", %{tmp_dir: dir} do
    log =
      capture_log(fn ->
        gateway = start(dir, [%{type: 4, uri: "mftp://" <> @events}], "not JSON")
        reader = Names.whereis(gateway, :event_definitions, @key)
        eventually(fn -> reports(gateway).asked? end)
        eventually(fn -> :sys.get_state(reader, Aerie.Patience.ms()).reading == nil end)
        event(gateway, 101)
        assert %{name: nil, values: nil} = shown(gateway, 101)
      end)

    assert [_before, _after] = String.split(log, "VID-001: Aerie's own definitions of events are used")
    assert log =~ "the events' metadata is not as MAVLink has it"
  end
end
