# Measures how fast all parameters of a simulated vehicle are read over UDP that loses frames in both directions: by
# the list (PARAM_REQUEST_LIST) and by ArduPilot's parameter file (MAVLink FTP), by Aerie's machines and by pymavlink,
# straight to the same vehicle.
#
#     bin/bench transfers [--rounds 5] [--params 1400]
#
# Columns: parameters per second, the median of the rounds, at each loss (share of frames in each direction). The
# vehicle sends at most 2,000 parameters a second of a list, as ArduPilot's simulator does, and 1,000 packets a second
# of a file. Aerie is told a round trip of 5 ms, as a link measures it; its file is read with checksums before and
# after it.

Code.require_file("harness.exs", __DIR__)
Code.require_file("../../apps/control/test/support/udp_transfer.ex", __DIR__)

defmodule TransfersBench do
  alias Aerie.Control.Params.{Fetch, Table}
  alias Aerie.Control.Params.Fetch.Download
  alias Aerie.UdpTransfer
  alias Bench.{Gateway, OSProcess, Python, Sample}

  @losses [0.0, 0.05, 0.25]
  @widths [28, -12, -12, -12]
  @minutes_us 120_000_000

  def main(%{rounds: rounds, params: params}) do
    peers =
      if python = Python.find("pymavlink"),
        do: [list: "pymavlink, list", file: "pymavlink, parameter file"],
        else: []

    ways =
      [
        {"Aerie, list", &aerie(Download, [rtt_us: 5_000], params, &1, &2)},
        {"Aerie, parameter file", &aerie(Fetch, [file: true, rtt_us: 5_000], params, &1, &2)}
      ] ++ for {way, name} <- peers, do: {name, &pymavlink(python, way, params, &1, &2)}

    IO.puts("#{params} parameters, parameters per second, median of #{rounds}\n")
    Bench.Table.columns(["" | for(loss <- @losses, do: "#{round(loss * 100)} % loss")], @widths)

    for {name, run} <- ways do
      cells = for loss <- @losses, do: cell(for(seed <- 1..rounds, rate = run.(loss, seed), do: rate), rounds)
      Bench.Table.columns([name | cells], @widths)
    end
  end

  defp cell([], _rounds), do: "failed"

  defp cell(rates, rounds) do
    failed = rounds - length(rates)
    "#{round(Sample.median(rates))}" <> if(failed > 0, do: " (#{failed} failed)", else: "")
  end

  defp vehicle(port, params, loss, seed) do
    more = for n <- 1..(params - 182), do: {"MORE_#{n}", n, Enum.at([2, 4, 6, 9], rem(n, 4))}
    # Its steps are as short as its fastest stream needs.
    sim = Gateway.sim(port, seed: seed, rates: %{30 => 100}, more_params: more)
    for direction <- [:in, :out], do: :ok = SimVehicle.fault(sim, :loss, loss, direction)
    sim
  end

  defp aerie(module, more, params, loss, seed) do
    {socket, port} = UdpTransfer.open()
    sim = vehicle(port, params, loss, seed)
    machine = module.new({1, 1}, UdpTransfer.now() + @minutes_us, more)

    {us, {{:ok, table}, _bytes}} =
      :timer.tc(fn -> UdpTransfer.run({socket, SimVehicle.port(sim)}, module, machine) end)

    GenServer.stop(sim)
    :gen_udp.close(socket)
    Table.count(table) / us * 1.0e6
  end

  defp pymavlink(python, way, params, loss, seed) do
    port = OSProcess.free_port(:gen_udp)
    peer = Task.async(fn -> Python.run(python, "pymavlink_peer.py", [way, port]) end)
    sim = vehicle(port, params, loss, seed)
    output = Task.await(peer, :infinity)
    GenServer.stop(sim)

    with [_all, count, seconds] <- Regex.run(~r/^#{way} (\d+) (\S+)$/m, output),
         count when count > 0 <- String.to_integer(count),
         do: count / String.to_float(seconds),
         else: (_failed -> nil)
  end
end

TransfersBench.main(Map.new(Bench.Options.read(__ENV__.file, rounds: 5, params: 1400)))
