# Measures how many mission items a second are sent and read at 0, 5 and 25 % loss in both directions, with a simulated
# ArduPilot on loopback, and what pymavlink with the protocol's own time-outs does with the same vehicle.
#
#     bin/bench mission [--items 200] [--seconds 120]
#
# Aerie's upload is not done before the plan was read back and compared: its time is that of both. pymavlink's ends
# with MISSION_ACK. "failed" is a transfer that gave up, or took longer than --seconds.

Code.require_file("harness.exs", __DIR__)
Code.require_file("../../apps/base/test/support/patience.ex", __DIR__)
Code.require_file("../../apps/vehicle/test/support/mission_station.ex", __DIR__)

defmodule MissionBench do
  alias Protocols.Mission.Item
  alias Aerie.MissionStation
  alias Aerie.Vehicle.Firmware.Ardupilot.Adapter
  alias Bench.{Gateway, OSProcess, Python, Table}

  @widths [19, -14, -14]

  def main(%{items: count, seconds: seconds}) do
    python = Python.find("pymavlink")
    peers = if python, do: [{"pymavlink", &theirs(python, count, seconds, &1)}], else: []
    IO.puts("#{count} items, items per second\n")
    Table.columns(["loss", "upload", "download"], @widths)

    for loss <- [0.0, 0.05, 0.25], {name, run} <- [{"aerie", &ours(items(count), seconds, &1)} | peers] do
      rates = for took <- run.(loss), do: if(took, do: round(count / max(took, 0.001)), else: "failed")
      Table.columns(["#{round(loss * 100)} %  #{name}" | rates], @widths)
    end
  end

  defp items(count) do
    for n <- 0..(count - 1) do
      command = if n == 1, do: 22, else: 16
      %Item{command: command, frame: 3, x: 473_977_420 + 10 * n, y: 85_455_940 + 7 * n, z: 20.0}
    end
  end

  defp vehicle(port, loss) do
    sim = Gateway.sim(port, seed: 7)
    for direction <- [:in, :out], do: :ok = SimVehicle.fault(sim, :loss, loss, direction)
    sim
  end

  # Seconds of the upload and of the download, nil for one that failed.
  defp ours(items, seconds, loss) do
    station = MissionStation.open()
    sim = vehicle(station.port, loss)

    {results, _station} =
      Enum.map_reduce([{:upload, items}, :download], MissionStation.meet(station, sim), fn transfer,
                                                                                           station ->
        MissionStation.transfer(station, transfer, 0, Ardupilot, ms: seconds * 1000)
      end)

    GenServer.stop(sim)
    for result <- results, do: if(result.status == :completed, do: result.ms / 1000)
  end

  defp theirs(python, count, seconds, loss) do
    port = OSProcess.free_port(:gen_udp)
    sim = vehicle(port, loss)
    output = Python.run(python, "pymavlink_peer.py", ["mission", port, count, seconds])
    GenServer.stop(sim)

    for name <- ["upload", "download"] do
      [_line, seconds] = Regex.run(~r/^#{name} (\S+)/m, output)
      if seconds != "failed", do: String.to_float(seconds)
    end
  end
end

MissionBench.main(Map.new(Bench.Options.read(__ENV__.file, items: 200, seconds: 120)))
