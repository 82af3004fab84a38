# Measures how many mission items a second are sent and read at 0, 5 and 25 % loss in both directions, with a simulated ArduPilot on
# loopback, and what pymavlink with the protocol's own time-outs does with the same vehicle.
#
#     bin/bench mission [--items 200] [--seconds 120]
#
# Aerie's upload is not done before the plan was read back and compared: its time is that of both. pymavlink's ends with MISSION_ACK.
# "failed" is a transfer that gave up, or took longer than --seconds.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("../../vehicle/test/support/mission_station.ex", __DIR__)

alias Protocols.Mission.Item
alias Aerie.MissionStation

options = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), items: 200, seconds: 120)
count = options[:items]
Logger.configure(level: :none)

items =
  for n <- 0..(count - 1),
      do: %Item{
        command: if(n == 1, do: 22, else: 16),
        frame: 3,
        x: 473_977_420 + 10 * n,
        y: 85_455_940 + 7 * n,
        z: 20.0
      }

vehicle = fn port, loss ->
  {:ok, sim} = SimVehicle.start_link(firmware: :ardupilot, link: "udpout:127.0.0.1:#{port}", seed: 7)
  for direction <- [:in, :out], do: :ok = SimVehicle.fault(sim, :loss, loss, direction)
  sim
end

ours = fn loss ->
  station = MissionStation.open()
  sim = vehicle.(station.port, loss)
  station = MissionStation.meet(station, sim)
  ms = options[:seconds] * 1000

  {up, station} =
    MissionStation.transfer(station, {:upload, items}, 0, Aerie.Vehicle.Protocol.Ardupilot, ms: ms)

  {down, _station} = MissionStation.transfer(station, :download, 0, Aerie.Vehicle.Protocol.Ardupilot, ms: ms)
  GenServer.stop(sim)
  for result <- [up, down], do: if(result.status == :completed, do: result.ms / 1000, else: nil)
end

python = Path.join(System.get_env("AERIE_VENV", Path.expand("../../../.venv", __DIR__)), "bin/python")
script = Path.expand("support/mission_peer.py", __DIR__)

theirs = fn loss ->
  {:ok, socket} = :gen_udp.open(0, ip: {127, 0, 0, 1})
  {:ok, port} = :inet.port(socket)
  :gen_udp.close(socket)
  sim = vehicle.(port, loss)

  {output, 0} =
    System.cmd(python, [script, "#{port}", "#{count}", "#{options[:seconds]}"], stderr_to_stdout: true)

  GenServer.stop(sim)

  for name <- ["upload", "download"] do
    [_line, seconds] = Regex.run(~r/#{name} (\S+)/, output)
    if seconds == "failed", do: nil, else: String.to_float(seconds)
  end
end

rate = fn
  nil -> String.pad_leading("failed", 14)
  seconds -> String.pad_leading("#{round(count / max(seconds, 0.001))}", 14)
end

IO.puts("#{count} items, items per second\n")
IO.puts("loss                       upload      download")

for loss <- [0.0, 0.05, 0.25],
    {name, run} <- [{"aerie", ours}] ++ if(File.exists?(python), do: [{"pymavlink", theirs}], else: []) do
  [up, down] = run.(loss)
  IO.puts(String.pad_trailing("#{round(loss * 100)} %  #{name}", 19) <> rate.(up) <> rate.(down))
end
