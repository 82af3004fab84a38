defmodule Aerie.Control.Ftp.SimulatedTest do
  @moduledoc "Parameters, files and logs of simulated vehicles over UDP that loses frames in both directions."

  use ExUnit.Case, async: true

  alias Aerie.Control.{Ftp, Logs, Params}
  alias Aerie.UdpTransfer
  alias Aerie.Control.Params.Table

  @log for i <- 1..20_000, into: "", do: <<rem(i * 7919, 251)>>

  setup %{test: test} do
    firmware = if to_string(test) =~ "PX4", do: :px4, else: :ardupilot
    {socket, port} = UdpTransfer.open()

    sim =
      start_supervised!(
        {SimVehicle,
         firmware: firmware,
         link: "udpout:127.0.0.1:#{port}",
         files: %{"/log.bin" => @log},
         logs: [@log],
         more_params: for(n <- 1..300, do: {"MORE_#{n}", n, 6})}
      )

    for direction <- [:in, :out], do: :ok = SimVehicle.fault(sim, :loss, 0.1, direction)
    %{socket: {socket, SimVehicle.port(sim)}, until: UdpTransfer.now() + 900_000_000}
  end

  for {name, encoding, hash} <- [{"ArduPilot", :c_cast, false}, {"PX4", :bytewise, true}] do
    test "#{name}: list, set, files and logs", %{socket: socket, until: until} do
      options = [encoding: unquote(encoding), hash: unquote(hash), rtt_us: 300_000]
      fetch = Params.Fetch.new({1, 1}, until, [file: unquote(name == "ArduPilot")] ++ options)
      assert {{:ok, %Table{} = table}, ""} = UdpTransfer.run(socket, Params.Fetch, fetch)
      assert table.params["MORE_300"].value == 300
      assert Table.count(table) > 400
      assert (table.hash || table.file_crc) != nil

      assert {{:ok, list}, ""} =
               UdpTransfer.run(
                 socket,
                 Params.Fetch.Download,
                 Params.Fetch.Download.new({1, 1}, until, options)
               )

      values = &Map.new(&1.params, fn {name, param} -> {name, param.value} end)
      assert values.(list) == values.(table)

      set = Params.Set.new("MORE_7", -5, {1, 1}, until, options)
      assert {{:ok, %{value: -5}}, ""} = UdpTransfer.run(socket, Params.Set, set)

      read = Ftp.Client.new({:read, "/log.bin"}, {1, 1}, until, rtt_us: 300_000)
      assert UdpTransfer.run(socket, Ftp.Client, read) == {{:ok, 20_000}, @log}

      assert {{:ok, [entry]}, ""} =
               UdpTransfer.run(socket, Logs.List, Logs.List.new({1, 1}, until, rtt_us: 300_000))

      log = Logs.Download.new(entry, {1, 1}, until, rtt_us: 300_000)
      assert UdpTransfer.run(socket, Logs.Download, log) == {{:ok, 20_000}, @log}
    end
  end
end
